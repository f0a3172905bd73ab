"""Power: the difference that a number of trials can detect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures.axes import (
    Kind,
    few,
    legend_above,
    new_figure,
    plain_numbers,
    whole_study,
)
from trl_explore.report.style import INK, MUTED
from trl_explore.statistics.power import (
    POWER,
    detectable_difference,
    fewest_pairs,
    trials_for_difference,
    trials_text,
)

COLOR = "#0072b2"


@dataclass(frozen=True)
class Pair:
    """A comparison: standard deviation of the paired difference, observed |difference|, verdict."""

    label: str
    sd: float
    difference: float
    told_apart: bool


def plot_power(ax: Axes, pairs: Sequence[Pair], *, trials: int, level: float) -> None:
    """Draw the smallest difference that is detected with 80 % power, by number of trials.

    The line is for the median standard deviation of the pairs; the band reaches from the smallest
    to the largest. Both begin at the fewest trials with which a difference can be
    significant. Each point is a pair: its observed difference, and the number of trials that would
    detect it with that power. For points left of the vertical line there were enough trials.

    Args:
        ax: empty axes.
        pairs: comparisons.
        trials: number of trials per configuration.
        level: confidence level of one test.

    """
    known = [p for p in pairs if np.isfinite(p.sd) and p.sd > 0]
    needed = [trials_for_difference(p.sd, p.difference, level=level) for p in known]
    shown = [(n, p) for n, p in zip(needed, known, strict=True) if n is not None and np.isfinite(n)]
    right = max([10 * trials, 1000, *(2 * n for n, _ in shown)])
    n = np.geomspace(fewest_pairs(level), right, 60)
    low, middle, high = np.quantile([p.sd for p in known], [0.0, 0.5, 1.0])
    curves = [detectable_difference(sd, n, level=level) for sd in (low, middle, high)]
    ax.fill_between(n, curves[0], curves[2], color=COLOR, alpha=0.15, lw=0)
    ax.plot(n, curves[1], color=COLOR)
    for count, pair in shown:
        ax.plot(
            [count], [abs(pair.difference)], ls="", marker="o" if pair.told_apart else "D",
            ms=5, color=INK if pair.told_apart else "#d55e00", zorder=4,
        )  # fmt: skip
    ax.axvline(trials, color=INK, lw=1.0, ls=(0, (4, 3)))
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(1.6, right)
    ax.set_xlabel("trials per configuration (logarithmic)")
    ax.set_ylabel("difference in iterations (logarithmic)")
    ax.grid()
    plain_numbers(ax.xaxis)
    plain_numbers(ax.yaxis)
    handles = [
        Line2D([], [], color=COLOR, label=f"detected with {100 * POWER:g} % power"),
        Line2D([], [], color=INK, lw=1.0, ls=(0, (4, 3)), label=f"this study: {trials:,} trials"),
        Line2D([], [], ls="", marker="o", color=INK, label="pair with a significant difference"),
        Line2D([], [], ls="", marker="D", color="#d55e00", label="pair without"),
    ]
    present = {p.told_apart for _, p in shown}
    legend_above(ax, handles[:2] + [h for h, k in zip(handles[2:], (True, False), strict=True)
                                    if k in present], columns=2)  # fmt: skip
    ax.tick_params(which="minor", color=MUTED)


def _pairs(e: GroupEvidence) -> list[Pair]:
    """The comparisons whose standard deviation is known and not zero."""
    labels = e.group.labels
    return [
        Pair(f"{labels[c.a]} vs. {labels[c.b]}", c.sd, c.difference.value, c.winner is not None)
        for c in e.comparisons
        if np.isfinite(c.sd) and c.sd > 0
    ]


def _trials(e: GroupEvidence) -> int:
    return min(min(c.n_a, c.n_b) for c in e.comparisons)


def _draw(e: GroupEvidence) -> Figure:
    """Draw at the level of one test after correction."""
    figure = new_figure(3.4)
    plot_power(figure.subplots(), _pairs(e), trials=_trials(e), level=e.strict_level)
    return figure


def _caption(e: GroupEvidence) -> str:
    pairs, n, level = _pairs(e), _trials(e), e.strict_level
    low, high = (
        float(detectable_difference(f([p.sd for p in pairs]), n, level=level)) for f in (min, max)
    )
    if n < (fewest := fewest_pairs(level)):
        found = (
            f"{n:,} trials per configuration cannot detect any difference, however large, after"
            f" correction for {len(e.comparisons)} pairs; at least {fewest} are needed."
        )
    else:
        found = (
            f"With {n:,} trials per configuration, a difference of {low:,.0f} iterations (the least"
            f" variable pair) to {high:,.0f} (the most variable pair) is detected with"
            f" {100 * POWER:g} % power after correction for {len(e.comparisons)} pairs."
        )
    return (
        f"{found} Each point is a pair: its observed difference, and the number of trials that"
        " would detect it. Pairs right of the dashed line need more trials than this study has."
        f" Band: from the least to the most variable pair.{_unsettled(pairs, level)}"
    )


def _unsettled(pairs: Sequence[Pair], level: float, most: int = 3) -> str:
    needed = [
        (p.label, trials_for_difference(p.sd, p.difference, level=level))
        for p in pairs
        if not p.told_apart
    ]
    texts = [f"{label} {trials_text(n)}" for label, n in needed if n is not None][:most]
    if not texts:
        return ""
    return f" Pairs without a significant difference, and the trials needed: {'; '.join(texts)}."


POWER_OF_STUDY = Kind(
    "power",
    "What this number of trials can show",
    lambda e: whole_study(e) and few(e) and len(_pairs(e)) > 0,
    _draw,
    _caption,
)
