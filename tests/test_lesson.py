"""The lesson: its checks accept the solutions, and say what is wrong with other answers.

That the notebook runs from top to bottom is tested where the documentation is built.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

LESSON = Path(__file__).resolve().parents[1] / "lesson"
CELLS = json.loads((LESSON / "lesson.ipynb").read_text(encoding="utf-8"))["cells"]


@pytest.fixture(scope="module")
def modules():
    sys.path.insert(0, str(LESSON))
    import checks
    import solutions

    yield checks, solutions
    sys.path.remove(str(LESSON))


@pytest.fixture
def said(modules, capsys):
    """What the check of an exercise prints about an answer."""

    def ask(exercise, answer):
        modules[0].check(exercise, answer)
        return capsys.readouterr().out

    return ask


def wrong_gradient(modules, **options):
    checks, _ = modules
    return lambda theta: checks.update(theta, checks.policy(theta), **options)


def test_the_solutions_are_right(said, modules):
    solved = modules[1]
    answers = [
        solved.policy_gradient, solved.corners, solved.iteration_to_pass,
        solved.corrected_update, solved.seeds_to_see,
    ]  # fmt: skip
    for exercise, answer in enumerate(answers, start=1):
        assert said(exercise, answer) == f"Exercise {exercise}: right.\n"


def test_the_notebook_asks_for_what_the_solutions_solve(modules):
    exercises = ["".join(cell["source"]) for cell in CELLS if "exercise" in str(cell["metadata"])]
    asked = [source for source in exercises if "check(" in source]
    assert len(asked) == 5
    for exercise, source in enumerate(asked, start=1):
        name = source.rpartition(f"check({exercise}, ")[2].rstrip(")\n")
        assert hasattr(modules[1], name)
    assert not any(cell.get("outputs") for cell in CELLS)


def test_the_time_of_the_sections_is_that_of_the_lesson():
    text = "".join("".join(cell["source"]) for cell in CELLS)
    minutes = [int(part.split("(")[-1]) for part in text.split(" minutes)")[:-1]]
    assert sum(minutes) == 45


def test_the_gradient_is_that_of_the_expected_return(modules):
    """At θ = 0: J = (1 − p) + 3 p q has ∂J/∂p = 0.5 and ∂J/∂q = 1.5, and p (1 − p) is 1/4."""
    gradient = modules[1].policy_gradient(np.zeros((2, 2)))
    np.testing.assert_allclose(gradient, [[-0.125, 0.125], [-0.375, 0.375]])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"score": lambda value: 1.0}, "without the return"),
        ({"score": lambda value: -value}, "downhill"),
        ({"centre": 0.0}, "the π is missing"),
        ({"steps": 1}, "Only the first step"),
        ({"score": lambda value: value**2}, "state A and action left is"),
    ],
)
def test_wrong_gradients(said, modules, options, message):
    assert message in said(1, wrong_gradient(modules, **options))


def test_answers_that_are_none(said, modules):
    checks, _ = modules
    for exercise in (1, 3, 5):
        assert "nothing so far" in said(exercise, lambda value: ...)
    assert "nothing so far" in said(4, lambda theta, mu: ...)
    assert "random: no weights so far" in said(2, {"random": ...})
    assert "shape (2, 2) of θ, not (2,)" in said(1, lambda theta: np.zeros(2))
    assert "raises NameError" in said(1, lambda theta: undefined)  # noqa: F821
    assert "its chance P(τ)" in said(1, lambda theta: checks.update(theta, np.ones((2, 2))))


@pytest.mark.parametrize(
    ("name", "weights", "message"),
    [
        ("random", (1, 0, 0), "argmax and uniform are exchanged"),
        ("argmax", (0, 1, 0), "which action this strategy takes"),
        ("epsilon_greedy", (0.3, 0, 0.7), "ε is the weight of the random action"),
        ("epsilon_greedy", (0.7, 0.3, 0), "not from the softmax"),
        ("epsilon_greedy", (0.7, 0, 0.7), "must sum to 1, not to 1.4"),
        ("epsilon_greedy", (0.7, 0.3), "three weights"),
        ("decaying_epsilon_greedy", (0.01, 0, 0.99), "multiplied by 0.99 in each of 100"),
    ],
)
def test_wrong_corners(said, modules, name, weights, message):
    out = said(2, {**modules[1].corners, name: weights})
    assert f"not yet. {name}: " in out
    assert message in out


def first(scores, window=100, least=lambda mean: mean > 195, start=None, offset=0):
    for i in range(window if start is None else start, len(scores) + 1):
        if least(np.mean(scores[max(0, i - window) : i])):
            return i + offset
    return None


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda s: first(s, start=1), "the window must be full"),
        (lambda s: first(s, offset=-1), "counted from 1"),
        (lambda s: first(s, least=lambda mean: mean >= 195), "exactly 195 is not enough"),
        (lambda s: first(s, window=10**6, start=100), "not all episodes so far"),
        (lambda s: next((i for i in range(100, len(s) + 1) if s[i - 1] > 195), None),
         "it is the mean of the last 100"),
        (lambda s: next((i for i in range(100, len(s) + 1, 100) if np.mean(s[i - 100 : i]) > 195),
                        None), "every iteration"),
    ],
)  # fmt: skip
def test_wrong_rules_of_passing(said, answer, message):
    out = said(3, answer)
    assert "not yet" in out
    assert message in out


def weighted(checks, weigh):
    def answer(theta, mu):
        pi = checks.policy(theta)
        return checks.update(theta, mu, lambda path, t: weigh(path, t, pi, mu))

    return answer


@pytest.mark.parametrize(
    ("weigh", "message"),
    [
        (lambda path, t, pi, mu: 1.0, "no weight is in it"),
        (lambda path, t, pi, mu: math.prod(mu[s] / pi[s] for s in path), "upside down"),
        (lambda path, t, pi, mu: pi[path[t]] / mu[path[t]], "Each step has its own ratio"),
        (lambda path, t, pi, mu: math.prod(pi[s] / mu[s] for s in path[: t + 1]), "up to the step"),
    ],
)
def test_wrong_corrections(said, modules, weigh, message):
    assert message in said(4, weighted(modules[0], weigh))


def test_a_correction_that_ignores_the_behaviour(said, modules):
    assert "μ is not used" in said(4, lambda theta, mu: modules[1].policy_gradient(theta))


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda rate: round(1 / rate), "see none"),
        (lambda rate: math.log(0.05) / math.log(1 - rate), "round up"),
        (lambda rate: math.floor(math.log(0.05) / math.log(1 - rate)), "one too few"),
        (lambda rate: math.ceil(math.log(0.95) / math.log(1 - rate)), "it should be 95 %"),
        (lambda rate: 1000, "the chance to see none is then"),
    ],
)
def test_wrong_numbers_of_agents(said, answer, message):
    assert message in said(5, answer)
