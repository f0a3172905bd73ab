"""What to see in a figure, in words made from its numbers. Plain text, not escaped."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from trl_explore.report import drawing
from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures.axes import number
from trl_explore.report.figures.power import Pair
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.power import (
    POWER,
    detectable_difference,
    fewest_pairs,
    trials_for_difference,
)


def survival(e: GroupEvidence) -> str:
    """Caption of the Kaplan-Meier curves in iterations."""
    n = _trials(e)
    bands = f" Bands: {100 * e.level:g} % intervals." if len(e.group.configurations) <= 6 else ""
    return (
        f"Each curve falls as trials converge; the sooner and deeper it falls, the better. What is"
        f" left at {e.group.cap:,} iterations was stopped there without passing. {_passed(e)}"
        f"{bands} Below: how many of {n} trials are still learning (Kaplan–Meier)."
    )


def survival_frames(e: GroupEvidence) -> str:
    """Caption of the Kaplan-Meier curves in frames."""
    return (
        "The same against environment steps, which cost the same on every machine. Trials that"
        " failed count as still learning to the end of the axis: strategies that fail badly have"
        " short episodes, and would look good if they left the count when they were stopped."
    )


def score(e: GroupEvidence) -> str:
    """Caption of the final scores."""
    return (
        f"One point per trial. {_passed(e)} A trial stops as soon as its score passes"
        f" {e.group.threshold:g}, so that passing trials lie just above the line, except those"
        f" that had passed before their {e.group.window}th episode."
    )


def iterations(e: GroupEvidence) -> str:
    """Caption of the iterations."""
    medians = _each(e, _median)
    return (
        f"Hollow points at the cap are not measurements of {e.group.cap:,} iterations: those trials"
        f" would have needed more, or would never have passed. Medians{_by(e)}: {medians}."
    )


def seconds(e: GroupEvidence) -> str:
    """Caption of the seconds."""
    timed = drawing.seconds(e.group)
    counts = {len(timed(c)[0]) for c in e.group.configurations} - {0}
    some = f"{min(counts)}" if len(counts) == 1 else f"{min(counts)} to {max(counts)}"
    means = _each(e, lambda c: f"{timed(c)[1].mean():.3g} s" if len(timed(c)[0]) else "not timed")
    return (
        f"Each trial was run by itself, in random order, after a warm-up; {some} trials per"
        f" configuration. Means{_by(e)}: {means}. Seconds depend on program and machine: here an"
        " iteration has a fixed cost beside that of its frames, which weighs on trials of many"
        " short episodes. The next figure does not depend on them."
    )


def frames(e: GroupEvidence) -> str:
    """Caption of the frames."""
    means = _each(e, lambda c: f"{c.frames.mean():,.0f}")
    return (
        "Environment steps until a trial stopped, the cost of learning that does not depend on the"
        f" machine. A trial that fails with short episodes uses few. Means{_by(e)}: {means}."
    )


def epsilon(e: GroupEvidence) -> str:
    """Caption of ε by iteration."""
    return (
        "The share of actions drawn at random in each iteration. The thesis chose 0.99 (thick),"
        f" which halves ε every {np.log(0.5) / np.log(0.99):.0f} iterations."
    )


def learning(e: GroupEvidence) -> str:
    """Caption of the learning curves."""
    bands = any(row.low is not None for row in e.learning)
    what = "Line: mean over trials" + (", band: the middle half of them" if bands else "")
    absent = "" if bands else " No bands: the episodes of these jobs were not recorded."
    missing = len(e.group.configurations) - len(e.learning)
    none = f" {missing} configurations have no recorded curve." if missing else ""
    return (
        f"{what}; thin: the other configurations. A trial that stopped keeps its last score. The"
        f" dashed line is the score to pass, {e.group.threshold:g}.{absent}{none}"
    )


def forest(e: GroupEvidence) -> str:
    """Caption of the forest plot."""
    real = sum(c.winner is not None for c in e.comparisons)
    shown = drawing.shown_pairs(e)
    some = (
        f" Shown are the {len(shown)} pairs with the fastest configuration; the table has all."
        if len(shown) < len(e.comparisons)
        else ""
    )
    return (
        f"How many iterations the first of a pair needs fewer than the second, on average (counted"
        f" to the cap), with {100 * e.level:g} % interval. Filled: told apart by interval and"
        f" permutation test after Holm's correction, {real} of {len(e.comparisons)}.{some}"
    )


def power(e: GroupEvidence) -> str:
    """Caption of the power figure."""
    pairs = drawing.power_pairs(e)
    n = min(min(c.n_a, c.n_b) for c in e.comparisons)
    level = drawing.strict_level(e)
    low, high = (
        float(detectable_difference(f([p.sd for p in pairs]), n, level=level)) for f in (min, max)
    )
    if n < (fewest := fewest_pairs(level)):
        found = (
            f"{n:,} trials per configuration find no difference, however large, after correction"
            f" for {len(e.comparisons)} pairs; that needs {fewest}."
        )
    else:
        found = (
            f"With {n:,} trials per configuration, a difference of {low:,.0f} (the pair that"
            f" varies least) to {high:,.0f} iterations (the one that varies most) is found with"
            f" {100 * POWER:g} % power after correction for {len(e.comparisons)} pairs."
        )
    return (
        f"{found} Each point is a pair: its observed difference, and how many trials would find"
        " it. Points right of the dashed line need more trials than there were. Band: from the"
        f" least to the most varying pair.{_unsettled(pairs, level)}"
    )


def _unsettled(pairs: Sequence[Pair], level: float, most: int = 3) -> str:
    needed = [
        (p.label, trials_for_difference(p.sd, p.difference, level=level))
        for p in pairs
        if not p.told_apart
    ]
    texts = [f"{label} {n:,}" for label, n in needed if n is not None][:most]
    return f" Not told apart, and the trials that this would take: {'; '.join(texts)}." * bool(
        texts
    )


def _trials(e: GroupEvidence) -> str:
    counts = {len(c) for c in e.group.configurations}
    return f"{min(counts):,}" if len(counts) == 1 else f"{min(counts):,} to {max(counts):,}"


def _each(e: GroupEvidence, text: Callable[[Outcomes], str]) -> str:
    parts = [f"{e.group.short(c.name)}: {text(c)}" for c in e.group.configurations[:9]]
    return "; ".join(parts) + (" …" if len(e.group.configurations) > 9 else "")


def _by(e: GroupEvidence) -> str:
    return f" by {e.group.parameter}" if e.group.parameter else ""


def _median(c: Outcomes) -> str:
    # The lower median: of an even number of trials the one that is reached first.
    middle = np.sort(np.where(c.converged, c.durations, np.inf))[(len(c) - 1) // 2]
    return number(float(middle)) if np.isfinite(middle) else "not reached"


def _passed(e: GroupEvidence) -> str:
    return f"Passed{_by(e)}: {_each(e, lambda c: f'{int(c.converged.sum())} of {len(c)}')}."
