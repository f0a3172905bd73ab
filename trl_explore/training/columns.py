"""The diagnostics: one entry for every quantity that the training records along a run.

``Diagnostics`` computes them, ``episodes.csv`` has a column for each, the readers of results check
their bounds, and the report draws them. This module imports nothing of the package.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf


@dataclass(frozen=True)
class Diagnostic:
    """A recorded quantity.

    Attributes:
        title: of its figure.
        axis: quantity and unit, for the axis of its figure.
        caption: what it is and how to read it.
        bounds: smallest and largest possible value.
        line: a value to compare with, drawn as a dashed line.
        may_be_log: draw it on a logarithmic axis where its values span much.
        from_zero: begin a linear axis at zero.
        policy: π or μ: drawn together with the entry of the other policy.

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
    "Entropy of the policy that is learned, π, and of what the agent did, μ, averaged over the"
    " states of an episode: 0 is certainty, the logarithm of the number of actions pure chance.",
)

DIAGNOSTICS: Mapping[str, Diagnostic] = {
    "entropy_policy": Diagnostic(*ENTROPY, policy="π"),
    "entropy_behaviour": Diagnostic(*ENTROPY, policy="μ"),
    "kl": Diagnostic(
        "How far μ was from π",
        "KL(μ‖π), nats",
        "KL(μ‖π), averaged over the states of an episode: 0 where the actions come from the policy"
        " that is being improved.",
    ),
    "ratio_mean": Diagnostic(
        "The mean ratio",
        "mean of π/μ over an episode",
        "Mean of π/μ over the actions of an episode. Its expectation is 1 where μ takes every"
        " action; argmax stays below, since what it never does is missing from the mean.",
        bounds=(0.0, inf),
        line=1.0,
        from_zero=False,
    ),
    "effective_sample_size": Diagnostic(
        "What the data are worth to π",
        "effective share of the frames",
        "Kong’s effective sample size of the ratios π/μ of an episode, as a share of its frames: 1"
        " where every frame counts alike for π, near 0 where a few frames outweigh all others. It"
        " counts actions one by one; weights of whole episodes are far worse. Argmax looks harmless"
        " here, since what it never does leaves no trace.",
        bounds=(0.0, 1.0),
    ),
    "exploratory": Diagnostic(
        "How many actions explored",
        "share of actions that are not greedy",
        "Share of actions that were not the one that π prefers.",
        bounds=(0.0, 1.0),
    ),
    "greedy_share": Diagnostic(
        "Lock-in",
        "share of the more frequent greedy action",
        "How often, in an episode, the policy preferred the action that it preferred most: at 1 it"
        " prefers the same action wherever it is, and argmax does nothing else.",
        bounds=(0.0, 1.0),
    ),
    "coverage": Diagnostic(
        "How much was seen",
        "cells visited so far",
        "Cells of the observation space that a trial has visited so far (one-hot states, or cubes"
        " of width 0.1). Long episodes see more.",
        bounds=(1.0, inf),
        may_be_log=True,
    ),
    "gradient_norm": Diagnostic(
        "How strong the signal was",
        "length of the gradient",
        "Euclidean length of the gradient of a trial’s loss, before the optimiser.",
        bounds=(0.0, inf),
        may_be_log=True,
    ),
}
"""In the order of the columns in the files."""

DIAGNOSTIC_COLUMNS = tuple(DIAGNOSTICS)
