"""The diagnostics: one entry for every quantity that training records, and for every plane.

``Diagnostics`` computes them, ``episodes.csv`` has one column for each, the readers of results
check their bounds, and the report draws them. This module imports nothing from the package.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf


@dataclass(frozen=True)
class Diagnostic:
    """A recorded quantity.

    Attributes:
        title: title of the figure.
        axis: quantity and unit, for the axis of the figure.
        caption: what it is and how to read it.
        bounds: smallest and largest possible value.
        line: reference value, drawn as a dashed line.
        may_be_log: use a logarithmic axis if the values span a wide range.
        from_zero: start a linear axis at zero.
        policy: the policy described, π or μ; both are drawn in one figure.
    """

    title: str
    axis: str
    caption: str
    bounds: tuple[float, float] = (-inf, inf)
    line: float | None = None
    may_be_log: bool = False
    from_zero: bool = True
    policy: str = ""


ENTROPY = (
    "How random the policies are",
    "entropy, nats",
    "Entropy of the learned policy π and of the behaviour μ, averaged over the states of an"
    " episode. A deterministic policy has 0, a uniform one the logarithm of the number of actions.",
)

DIAGNOSTICS: Mapping[str, Diagnostic] = {
    "entropy_policy": Diagnostic(*ENTROPY, policy="π"),
    "entropy_behaviour": Diagnostic(*ENTROPY, policy="μ"),
    "kl": Diagnostic(
        "How far μ was from π",
        "KL(μ‖π), nats",
        "KL(μ‖π), averaged over the states of an episode. It is 0 if the actions are drawn from"
        " the learned policy.",
    ),
    "ratio_mean": Diagnostic(
        "The mean ratio",
        "mean of π/μ over an episode",
        "Mean of π/μ over the actions of an episode. Its expectation is 1 if μ takes every action"
        " with positive probability. Argmax stays below 1: the mean lacks the actions that it"
        " never takes.",
        bounds=(0.0, inf),
        line=1.0,
        from_zero=False,
    ),
    "effective_sample_size": Diagnostic(
        "What the data are worth to π",
        "effective share of the frames",
        "Kong’s effective sample size of the ratios π/μ of an episode, as a share of its frames: 1"
        " if all frames have equal weight, near 0 if a few outweigh all others. It weights single"
        " actions; weights of whole episodes are far worse. Argmax looks harmless here, because"
        " the actions that it never takes are not in the data.",
        bounds=(0.0, 1.0),
    ),
    "exploratory": Diagnostic(
        "How many actions explored",
        "share of actions that are not greedy",
        "Share of actions other than the greedy action of π.",
        bounds=(0.0, 1.0),
    ),
    "greedy_share": Diagnostic(
        "Lock-in",
        "share of the more frequent greedy action",
        "Share of the frames of an episode whose greedy action is the most frequent one. At 1 the"
        " greedy action is the same in every state visited, and argmax takes no other.",
        bounds=(0.0, 1.0),
    ),
    "coverage": Diagnostic(
        "How much was seen",
        "cells visited so far",
        "Cells of the observation space that a trial has visited so far (one-hot states, or cubes"
        " of width 0.1). Long episodes visit more.",
        bounds=(1.0, inf),
        may_be_log=True,
    ),
    "gradient_norm": Diagnostic(
        "How large the gradient was",
        "norm of the gradient",
        "Euclidean norm of the gradient of a trial’s loss, before the optimiser step.",
        bounds=(0.0, inf),
        may_be_log=True,
    ),
}
"""In the order of the columns in the files."""

DIAGNOSTIC_COLUMNS = tuple(DIAGNOSTICS)


@dataclass(frozen=True)
class Feature:
    """A feature of an observation, with its limits in a histogram.

    Attributes:
        index: its place in the observation.
        label: quantity and unit.
        low: the left or lower limit.
        high: the right or upper limit.
    """

    index: int
    label: str
    low: float
    high: float


BINS = 32
"""The cells of a histogram along each feature."""
_CART = (Feature(0, "cart position", -2.4, 2.4), Feature(2, "pole angle, rad", -0.21, 0.21))
_CAR = (Feature(0, "position", -1.2, 0.6), Feature(1, "velocity", -0.07, 0.07))
_PENDULUM = (Feature(1, "sin θ (0: up or down)", -1, 1), Feature(0, "cos θ (1: up)", -1, 1))

PLANES: Mapping[str, tuple[Feature, Feature]] = {
    "CartPole-v1": _CART,
    "MountainCar-v0": _CAR,
    "trl_explore/SparseMountainCar-v0": _CAR,
    "Acrobot-v1": (Feature(1, "sin θ₁", -1, 1), Feature(0, "cos θ₁ (1: down)", -1, 1)),
    "Pendulum-v1": _PENDULUM,
    "trl_explore/SwingUp-v0": _PENDULUM,
    "LunarLander-v3": (Feature(0, "horizontal position", -1, 1), Feature(1, "height", -0.1, 1.5)),
}
"""Environment -> the two features, across and up, whose histogram shows where the trials were."""
