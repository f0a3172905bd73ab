"""What to see in figures of layouts and of recorded quantities. Plain text, not escaped."""

from __future__ import annotations

import numpy as np

from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures.learning import Row

SAMPLES = {
    "kl": "KL(μ‖π), averaged over the states of an episode: 0 where the actions come from the"
    " policy that is being improved.",
    "effective_sample_size": "Kong’s effective sample size of the ratios π/μ of an episode, as a"
    " share of its frames: 1 where every frame counts alike for π, near 0 where a few frames"
    " outweigh all others. It counts actions one by one; weights of whole episodes are far worse."
    " Argmax looks harmless here, since what it never does leaves no trace.",
    "ratio_mean": "Mean of π/μ over the actions of an episode. Its expectation is 1 where μ takes"
    " every action; argmax stays below, since what it never does is missing from the mean.",
    "exploratory": "Share of actions that were not the one that π prefers.",
    "greedy_share": "How often, in an episode, the policy preferred the action that it preferred"
    " most: at 1 it prefers the same action wherever it is, and argmax does nothing else.",
    "coverage": "Cells of the observation space that a trial has visited so far (one-hot states,"
    " or cubes of width 0.1). Long episodes see more.",
    "gradient_norm": "Euclidean length of the gradient of a trial’s loss, before the optimiser.",
}
HOW = (
    " Median and middle half of the trials, averaged over 20 iterations; one that stopped keeps its"
    " last value."
)


def map_pass(e: GroupEvidence) -> str:
    """Caption of the map of pass rates."""
    return (
        f"Percent of {_trials(e)} trials that pass; light is good. {_frame(e)}With so few trials, a"
        f" cell is uncertain by up to ±{_width(e):.0f} points: read the map for its shape."
    )


def map_iterations(e: GroupEvidence) -> str:
    """Caption of the map of restricted means."""
    return (
        "Mean number of iterations to convergence, a trial that failed counted as"
        f" {e.group.cap:,}; light is fast. {_frame(e)}"
    )


def effects(e: GroupEvidence) -> str:
    """Caption of the effects of options."""
    layout = e.group.crossed
    assert layout is not None
    return (
        f"Left: share of {_trials(e)} trials that pass, with Wilson intervals. Right: mean number"
        f" of iterations, a trial that failed counted as {e.group.cap:,}, with intervals of"
        f" {100 * e.level:g} %. Circles: {layout.options[0]}."
    )


def survival(e: GroupEvidence) -> str:
    """Caption of the Kaplan-Meier curves in panels."""
    return (
        "Each curve falls as trials converge; what is left at the end of the axis was stopped at"
        f" the cap of {e.group.cap:,} iterations without passing (Kaplan–Meier)."
        f" Bands: {100 * e.level:g} % intervals."
    )


def learning(e: GroupEvidence) -> str:
    """Caption of the learning curves in panels."""
    return (
        "Mean over trials; a trial that stopped keeps its last score. The dashed line is the score"
        f" to pass, {e.group.threshold:g}."
    )


def evaluation(e: GroupEvidence) -> str:
    """Caption of the evaluations."""
    gains = []
    for name, (training, greedy) in list(e.traces.evaluations.items())[:6]:
        ends = greedy.mean[-1] - training.mean[-1]
        sign = "+" if ends >= 0 else "−"
        gains.append(f"{e.group.labels[name]} {sign}{abs(ends):.3g}")
    return (
        "The score of training contains what the exploration itself costs; dashed, the same agents"
        " play the greedy action in episodes of their own, from which nothing is learned. Means"
        " over trials; a trial that stopped keeps its last score. Greedy minus training at the"
        f" end: {'; '.join(gains)}."
    )


def diagnostic(name: str, e: GroupEvidence) -> str:
    """Caption of a recorded quantity."""
    return f"{SAMPLES[name]}{HOW}{_ends(e, e.traces.diagnostics[name])}"


def entropy(e: GroupEvidence) -> str:
    """Caption of the entropies."""
    return (
        "Entropy of the policy that is learned, π, and of what the agent did, μ, averaged over the"
        f" states of an episode: 0 is certainty, the logarithm of the number of actions pure"
        f" chance.{HOW}"
    )


def _ends(e: GroupEvidence, rows: dict[str, Row]) -> str:
    """Where the curves of the first options stand in the middle of the run."""
    layout = e.group.crossed
    names = [n for (_, o), n in sorted(layout.cells.items()) if o == 0] if layout else list(rows)
    texts = [
        f"{layout.rows[k] if layout else e.group.labels[n]}: {_short(level(rows[n]))}"
        for k, n in enumerate(names)
        if n in rows
    ]
    who = f", {layout.options[0]}" if layout else ""
    return f" Mean of the line over all iterations{who}: {'; '.join(texts[:9])}."


def _short(value: float) -> str:
    """A number in two digits, without powers of ten.

    >>> _short(3.2e-10), _short(0.0966), _short(6620.0)
    ('< 0.001', '0.097', '6,620')
    """
    if 0 < abs(value) < 1e-3:
        return "< 0.001"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.2g}"


def level(row: Row) -> float:
    """Mean of a curve over its iterations."""
    return float(np.mean(row.mean))


def _trials(e: GroupEvidence) -> str:
    counts = {len(c) for c in e.group.configurations}
    return f"{min(counts):,}" if len(counts) == 1 else f"{min(counts):,} to {max(counts):,}"


def _frame(e: GroupEvidence) -> str:
    layout = e.group.plane
    name = layout.reference if layout is not None else None
    return f"Framed: {e.group.labels[name]}, the thesis’s softmax. " if name else ""


def _width(e: GroupEvidence) -> float:
    return max(50 * (s.pass_rate.high - s.pass_rate.low) for s in e.summaries)
