"""The checks of the lesson's exercises: each says what is wrong with an answer."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.strategies import (
    Argmax,
    DecayingEpsilonGreedy,
    EpsilonGreedy,
    Random,
    Softmax,
)
from trl_explore.strategies.mixture import MixtureStrategy

Array = NDArray[np.float64]
Step = tuple[int, int]

PATHS: Sequence[tuple[list[Step], float]] = (
    ([(0, 0)], 1.0),
    ([(0, 1), (1, 0)], 0.0),
    ([(0, 1), (1, 1)], 3.0),
)
"""The paths of the two-state problem: states and actions, and the return."""
POINTS = (
    np.array([[0.0, 0.4], [0.3, -0.2]]),
    np.array([[1.0, -0.5], [-0.4, 0.9]]),
    np.array([[0.2, 0.1], [0.0, 0.6]]),
)
"""Weights θ [states, actions] at which answers are compared."""
DELAYED = 100
"""The iteration in which exercise 2 asks for decaying ε-greedy."""


def check(exercise: int, answer: Any) -> None:
    """Print whether the answer to an exercise is right, and if not, why."""
    try:
        wrong = CHECKS[exercise](answer)
    except Exception as error:  # any error of the answer itself
        wrong = f"it raises {type(error).__name__}: {error}"
    print(f"Exercise {exercise}: {f'not yet. {wrong}' if wrong else 'right.'}")


def policy(theta: Array) -> Array:
    """π(a|s) = softmax(θ_s)_a [states, actions]."""
    powers = np.exp(theta - theta.max(axis=1, keepdims=True))
    return powers / powers.sum(axis=1, keepdims=True)


def update(
    theta: Array,
    chances: Array,
    weigh: Callable[[list[Step], int], float] = lambda path, step: 1.0,
    *,
    score: Callable[[float], float] = lambda value: value,
    steps: int = 2,
    centre: float = 1.0,
) -> Array:
    """Σ_τ P(τ) R(τ) Σ_t w_t ∇log π(a_t|s_t), or a variant with a typical mistake."""
    probs, total = policy(theta), np.zeros_like(theta)
    for path, value in PATHS:
        chance = math.prod(chances[step] for step in path)
        for t, (state, action) in enumerate(path[:steps]):
            gradient = np.eye(2)[action] - centre * probs[state]
            total[state] += chance * score(value) * weigh(path, t) * gradient
    return total


def _array(value: Any) -> str | Array:
    """The answer as an array [2, 2], or what is wrong with its form."""
    if value is None or value is ...:
        return "The function returns nothing so far."
    found = np.asarray(value, dtype=np.float64)
    if found.shape != (2, 2):
        return f"The result must have the shape (2, 2) of θ, not {found.shape}."
    return found if np.isfinite(found).all() else "The result has numbers that are not finite."


def _diagnose(found: Array, right: Array, mistakes: Mapping[str, Array]) -> str | None:
    """What is wrong with an array: the mistake whose result it is, or the first wrong entry."""
    if np.allclose(found, right, atol=1e-5):
        return None
    for message, wrong in mistakes.items():
        if np.allclose(found, wrong, atol=1e-5):
            return message
    state, action = np.argwhere(~np.isclose(found, right, atol=1e-5))[0]
    return (
        f"The entry of state {'AB'[state]} and action {('left', 'right')[action]} is "
        f"{found[state, action]:.3f} at a θ where it should be {right[state, action]:.3f}."
    )


def gradient_by_hand(answer: Callable[[Array], Any]) -> str | None:
    """Exercise 1: the policy gradient from the three paths."""
    return next(filter(None, (_gradient_at(theta, answer) for theta in POINTS)), None)


def _gradient_at(theta: Array, answer: Callable[[Array], Any]) -> str | None:
    found, probs = _array(answer(theta.copy())), policy(theta)
    if isinstance(found, str):
        return found
    right = update(theta, probs)
    return _diagnose(found, right, {
        "Every path counts the same: multiply each with its chance P(τ).":
            update(theta, np.ones((2, 2))),
        "It is always 0: without the return R(τ), what makes one action more probable cancels out.":
            update(theta, probs, score=lambda value: 1.0),
        "The sign is the wrong way round: this goes downhill.": -right,
        "∇log π(a|s) of a softmax is (1 for a, else 0) minus π(·|s); the π is missing.":
            update(theta, probs, centre=0.0),
        "Only the first step of a path is used: sum over all of its steps.":
            update(theta, probs, steps=1),
        "This is ∇π instead of ∇log π: divide by the chance of the action.":
            update(theta, probs, lambda path, t: float(probs[path[t]])),
    })  # fmt: skip


def _corner(strategy: MixtureStrategy) -> tuple[float, ...]:
    return tuple(float(weight) for weight in strategy.mixture()[:3])


def triangle(answer: Mapping[str, Sequence[float] | None]) -> str | None:
    """Exercise 2: the weights of argmax, softmax and uniform in each strategy."""
    decaying = DecayingEpsilonGreedy(0.99)
    for _ in range(DELAYED):
        decaying.step()
    strategies = {
        "random": Random(), "argmax": Argmax(), "softmax": Softmax(),
        "epsilon_greedy": EpsilonGreedy(0.3), "decaying_epsilon_greedy": decaying,
    }  # fmt: skip
    for name, strategy in strategies.items():
        given, right = answer.get(name), _corner(strategy)
        if given is None or given is ...:
            return f"{name}: no weights so far."
        if len(given) != 3:
            return f"{name}: three weights (argmax, softmax, uniform) are needed, not {len(given)}."
        if abs(sum(given) - 1) > 1e-3:
            return f"{name}: the weights must sum to 1, not to {sum(given):.3g}."
        if not np.allclose(given, right, atol=2e-3):
            return f"{name}: {_misplaced(name, tuple(given), right)}"
    return None


def _misplaced(name: str, given: tuple[float, ...], right: tuple[float, ...]) -> str:
    greedy, _, uniform = right
    if np.allclose(given, (uniform, 0, greedy), atol=2e-3) and greedy != uniform:
        if greedy in (0, 1):
            return "argmax and uniform are exchanged."
        return "ε is the weight of the random action; argmax has the rest, 1 − ε."
    if given[1] and "greedy" in name:
        return "an ε-greedy agent draws its random actions uniformly, not from the softmax."
    if name == "decaying_epsilon_greedy":
        return f"ε starts at 1 and is multiplied by 0.99 in each of {DELAYED} iterations."
    return "ask which action this strategy takes, and how often."


def passing(answer: Callable[[list[float]], Any]) -> str | None:
    """Exercise 3: the iteration at which a trial passes."""
    cases: Sequence[tuple[list[float], int | None, Mapping[Any, str]]] = (
        ([196.0] * 150, 100, {
            1: "It passes after one episode: the window must be full, with 100 episodes.",
            99: "Iterations are counted from 1: the first full window is complete after 100.",
            150: "It gives the last iteration: the first one that qualifies is asked for.",
        }),
        ([195.0] * 150, None, {
            100: "A mean of exactly 195 is not enough: it must exceed 195.",
        }),
        ([0.0] * 100 + [300.0] * 100, 166, {
            101: "One episode above 195 is not enough: it is the mean of the last 100 that counts.",
            None: "Use the last 100 episodes at every iteration, not all episodes so far.",
            165: "Iterations are counted from 1.",
            200: "Look at every iteration, not only at every hundredth.",
        }),
        ([500.0] * 45 + [0.0] * 100, 100, {
            45: "The window must be full before it counts, even if the mean so far is high.",
            None: "The first 100 episodes have a mean of 225: that is enough, whatever follows.",
        }),
        ([100.0] * 150, None, {
            150: "A trial that never passes has no such iteration: return None.",
            -1: "A trial that never passes has no such iteration: return None.",
        }),
    )  # fmt: skip
    if answer([0.0]) is ...:
        return "The function returns nothing so far."
    for scores, right, mistakes in cases:
        found = answer(list(scores))
        if found != right:
            said = f"For {_shown(scores)} it gives {found}, not {right}."
            return mistakes.get(found, said)
    return None


def _shown(scores: list[float]) -> str:
    """A list of scores in words: 150 × 196."""
    values = list(dict.fromkeys(scores))
    return " then ".join(f"{scores.count(value)} × {value:g}" for value in values)


def correction(answer: Callable[[Array, Array], Any]) -> str | None:
    """Exercise 4: the expected update under μ, weighted so that it is the gradient."""
    wrong = next(filter(None, (_correction_at(theta, answer) for theta in POINTS)), None)
    if wrong is None and not isinstance(_array(answer(POINTS[0], np.full((2, 2), np.nan))), str):
        return "Right numbers, but μ is not used. An agent's paths come from μ: weight those."
    return wrong


def _correction_at(theta: Array, answer: Callable[[Array, Array], Any]) -> str | None:
    probs = policy(theta)
    mu = 0.7 * np.eye(2)[theta.argmax(axis=1)] + 0.3 / 2
    ratio = probs / mu
    found = _array(answer(theta.copy(), mu.copy()))
    if isinstance(found, str):
        return found

    def whole(path: list[Step], t: int) -> float:
        return math.prod(ratio[step] for step in path)

    return _diagnose(found, update(theta, probs), {
        "This is still the biased update: no weight is in it.": update(theta, mu),
        "The weight is upside down: what μ does too often must count less, so π / μ.":
            update(theta, mu, lambda path, t: 1 / whole(path, t)),
        "Each step has its own ratio π/μ. That corrects the action, but not how often μ comes "
        "to the state; the weight of a path is the product over all of its steps.":
            update(theta, mu, lambda path, t: ratio[path[t]]),
        "A product up to the step itself is not enough here: the return comes after it.":
            update(theta, mu, lambda path, t: whole(path[: t + 1], t)),
        "The chances of the paths are those under π, and weighted on top: use those under μ.":
            update(theta, probs, whole),
    })  # fmt: skip


def seeds(answer: Callable[[float], Any]) -> str | None:
    """Exercise 5: how many agents it takes to see a failure."""
    for rate in (0.05, 1 / 60, 0.5):
        found, right = answer(rate), math.ceil(math.log(0.05) / math.log(1 - rate))
        if found is None or found is ...:
            return "The function returns nothing so far."
        if found == right:
            continue
        if found in (round(1 / rate), math.ceil(1 / rate)):
            return (
                f"With 1 / rate = {found} agents one failure is expected, but "
                f"{(1 - rate) ** found:.0%} of such studies see none."
            )
        if not float(found).is_integer():
            return f"{found:.2f} agents cannot be trained: round up."
        if found == right - 1:
            return f"{found} agents are one too few: round up, not down."
        if found == math.ceil(math.log(0.95) / math.log(1 - rate)):
            return "This is a chance of 5 % to see a failure; it should be 95 %."
        return (
            f"For a rate of {rate:.3g} it gives {found}: the chance to see none is then "
            f"{(1 - rate) ** float(found):.3g}, and it should be just below 0.05."
        )
    return None


CHECKS: Mapping[int, Callable[[Any], str | None]] = {
    1: gradient_by_hand,
    2: triangle,
    3: passing,
    4: correction,
    5: seeds,
}
