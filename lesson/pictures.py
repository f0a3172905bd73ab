"""The pictures of the lesson."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from trl_explore.names import STRATEGIES, strategy_label

Array = NDArray[np.float64]
CORNERS = np.array([[1.0, 0.0], [0.5, 3**0.5 / 2], [0.0, 0.0]])
"""Where argmax, softmax and uniform are in the triangle."""


def _line(name: str) -> dict[str, Any]:
    look = STRATEGIES[name].look
    return {"label": strategy_label(name), "color": look[0] if look else None}


def logits(p: float, q: float) -> Array:
    """The θ of the two-state problem whose chances to go right are p in A and q in B."""
    return np.array([[0.0, np.log(p / (1 - p))], [0.0, np.log(q / (1 - q))]])


def square(title: str) -> Axes:
    """The square of all policies of the two-state problem; its shade is the expected return."""
    _, ax = plt.subplots(figsize=(4.6, 4.2), layout="constrained")
    p, q = np.meshgrid(np.linspace(0, 1, 101), np.linspace(0, 1, 101))
    shade = ax.contourf(p, q, (1 - p) + 3 * p * q, levels=12, cmap="Greys", alpha=0.7)
    plt.colorbar(shade, label="expected return J", shrink=0.75)
    ax.set(title=title, xlabel="π(right | A)", ylabel="π(right | B)", aspect="equal")
    return ax


def climb(ax: Axes, step: Callable[[Array], Array], p: float, q: float, color: str) -> None:
    """Draw where a policy goes that follows ``step`` from (p, q)."""
    theta, way = logits(p, q), [(p, q)]
    for _ in range(400):
        theta = theta + 0.2 * step(theta)
        right = 1 / (1 + np.exp(theta[:, 0] - theta[:, 1]))
        way.append((float(right[0]), float(right[1])))
    ax.plot(*zip(*way, strict=True), color=color)
    ax.plot(*way[0], "o", mfc="white", color=color)
    ax.plot(*way[-1], "o", color=color, clip_on=False)


def arrows(ax: Axes, step: Callable[[Array], Array], color: str, label: str) -> None:
    """Draw the direction of ``step`` all over the square."""
    at = [(p, q) for p in np.linspace(0.06, 0.94, 10) for q in np.linspace(0.06, 0.94, 10)]
    steps = [step(logits(p, q)) for p, q in at]
    # In the units of the square: dp = p (1 - p) d(logit).
    moves = np.array([(s[:, 1] - s[:, 0]) * np.multiply(x, np.subtract(1, x))
                      for s, x in zip(steps, at, strict=True)])  # fmt: skip
    moves /= np.linalg.norm(moves, axis=1, keepdims=True) + 1e-9
    ax.quiver(*np.array(at).T, *moves.T, color=color, label=label, scale=16, width=0.006)


def triangle(corners: Mapping[str, Any]) -> None:
    """Draw strategies, if their weights are given, between argmax, softmax and uniform."""
    _, ax = plt.subplots(figsize=(5, 4), layout="constrained")
    ax.plot(*CORNERS[[0, 1, 2, 0]].T, color="0.7")
    for place, text, va in zip(CORNERS, ("argmax", "softmax", "uniform"), "tbt", strict=True):
        side = {"t": "top", "b": "bottom"}[va]
        lift = 0.05 if va == "b" else -0.05
        ax.text(place[0], place[1] + lift, text, ha="center", va=side, color="0.4")
    for name, weights in corners.items():
        if weights is not ...:
            ax.plot(*(np.array(weights) @ CORNERS), "o", markersize=10, **_line(name))
    if len(ax.lines) > 1:
        ax.legend(loc="upper left", bbox_to_anchor=(0.72, 1.0), frameon=False)
    ax.set(aspect="equal", xlim=(-0.15, 1.45), ylim=(-0.2, 1.05))
    ax.axis("off")


def curves(runs: Mapping[str, Any]) -> None:
    """Draw what the agents of each strategy score while they explore."""
    figure, ax = plt.subplots(figsize=(7.5, 3.4), layout="constrained")
    longest = max(trainer.trials.iteration for trainer in runs.values())
    for name, trainer in runs.items():
        score = trainer.trials.curves()["score"]
        ax.plot(np.pad(score, (0, longest - len(score)), mode="edge"), **_line(name))
    ax.axhline(195, color="0.6", linestyle=":")
    ax.set(xlabel="iteration", ylabel="mean of the last 100 scores")
    figure.legend(loc="outside right upper", frameon=False)


def both(runs: Mapping[str, Any]) -> None:
    """Draw what the agents score with their strategy, and without it."""
    figure, ax = plt.subplots(figsize=(7, 3.2), layout="constrained")
    place = np.arange(len(runs))
    colours = [_line(name)["color"] for name in runs]
    acting = [trainer.trials.score.mean() for trainer in runs.values()]
    learned = [trainer.evaluator.learned_score.mean() for trainer in runs.values()]
    ax.bar(place - 0.2, acting, 0.36, color=colours, alpha=0.45, label="while it explores")
    ax.bar(place + 0.2, learned, 0.36, color=colours, label="its policy, without the strategy")
    ax.set_xticks(place, [strategy_label(name) for name in runs])
    ax.set(ylabel="mean score")
    figure.legend(loc="outside upper center", ncols=2, frameon=False)


def rates(passed: NDArray[np.bool_], sizes: Iterable[int]) -> None:
    """Draw which pass rates studies of n agents report, if the agents are drawn from these."""
    rng, sizes = np.random.default_rng(0), list(sizes)
    figure, axes = plt.subplots(1, len(sizes), figsize=(8, 2.6), sharex=True, layout="constrained")
    for ax, n in zip(axes, sizes, strict=True):
        seen = rng.choice(passed, (4000, n)).mean(axis=1)
        ax.hist(seen, bins=np.arange(0.675, 1.03, 0.025), color="#0072b2")
        ax.axvline(passed.mean(), color="black", linestyle=":")
        ax.set(title=f"{n} agents", yticks=[])
    figure.supxlabel("reported pass rate")
