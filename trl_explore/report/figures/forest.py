"""Forest plot: how many iterations one configuration saves against another, for all pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures.axes import legend_above, new_figure, plain_numbers, wrapped
from trl_explore.report.figures.kind import Kind
from trl_explore.report.style import GRID, INK, MUTED, PAPER, Style
from trl_explore.statistics.comparisons import Comparison
from trl_explore.statistics.estimates import LEVEL, Estimate

MOST_PAIRS = 15
"""Pairs in a forest plot; of more, those with the fastest configuration are shown."""


@dataclass(frozen=True)
class Row:
    """One pair: ``difference`` is what the first needs less than the second."""

    first: str
    second: str
    difference: Estimate
    told_apart: bool
    style: Style


def pair_label(row: Row) -> str:
    """The name of a row: A vs. B, in two lines where that is long."""
    first, second = wrapped(row.first, 36, 1), wrapped(row.second, 36, 1)
    return f"{first} vs. {second}" if len(first) + len(second) <= 26 else f"{first}\nvs. {second}"


def plot_forest(ax: Axes, rows: Sequence[Row]) -> None:
    """Draw each pair's difference with its interval; hollow where it may be chance.

    Args:
        ax: empty axes.
        rows: pairs, from top to bottom.

    """
    for y, row in enumerate(rows):
        e = row.difference
        if np.isfinite([e.low, e.high]).all():
            ax.plot([e.low, e.high], [y, y], color=row.style.color, lw=1.7, zorder=2)
        ax.plot(
            [e.value], [y], marker=row.style.marker, ms=6, mec=row.style.color,
            mfc=row.style.color if row.told_apart else PAPER, zorder=3,
            label="told apart" if row.told_apart else "open",
        )  # fmt: skip
    ax.axvline(0, color=INK, lw=1.0)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.set_yticks(range(len(rows)), [pair_label(row) for row in rows])
    ax.tick_params(axis="y", length=0, labelsize=8.5)
    ax.spines["left"].set_visible(False)
    ax.grid(axis="x")
    ax.grid(axis="y", color=GRID, lw=0.4)
    ax.set_xlabel("the first needs fewer by (iterations)")
    plain_numbers(ax.xaxis)
    entries = [("told apart", True, MUTED), ("may be chance", False, PAPER)]
    handles = [
        Line2D([], [], color=MUTED, marker="o", mfc=face, label=label)
        for label, kind, face in entries
        if any(row.told_apart == kind for row in rows)
    ]
    legend_above(ax, handles, columns=2)


def oriented(comparison: Comparison) -> tuple[str, str, Estimate]:
    """Faster and slower configuration of a pair, and what the first saves."""
    e = comparison.difference
    if e.value > 0:
        return comparison.b, comparison.a, e
    return comparison.a, comparison.b, Estimate(-e.value, -e.high, -e.low, e.level)


def _shown(e: GroupEvidence) -> list[Comparison]:
    """The comparisons of the plot: all of them, or those with the fastest."""
    if len(e.comparisons) <= MOST_PAIRS or e.group.crossed is not None:
        return e.comparisons
    best = min(e.group.configurations, key=lambda c: float(c.durations.mean())).name
    return [c for c in e.comparisons if best in (c.a, c.b)]


def _draw(e: GroupEvidence) -> Figure:
    """The shown pairs, the largest difference on top."""
    labels, looks, layout = e.group.labels, e.group.styles, e.group.crossed
    rest = {n: layout.options[o] for (_, o), n in layout.cells.items()} if layout else labels
    rows = []
    for comparison in _shown(e):
        first, second, difference = oriented(comparison)
        told_apart = comparison.winner is not None
        rows.append(Row(labels[first], rest[second], difference, told_apart, looks[first]))
    rows.sort(key=lambda row: -row.difference.value)
    figure = new_figure(1.15 + sum(0.215 + 0.13 * pair_label(r).count("\n") for r in rows))
    plot_forest(figure.subplots(), rows)
    return figure


def _caption(e: GroupEvidence) -> str:
    real, shown = sum(c.winner is not None for c in e.comparisons), _shown(e)
    some = (
        f" Shown are the {len(shown)} pairs with the fastest configuration; the table has all."
        if len(shown) < len(e.comparisons)
        else ""
    )
    return (
        f"How many iterations the first of a pair needs fewer than the second, on average (counted"
        f" to the cap), with {100 * LEVEL:g} % interval. Filled: told apart by interval and"
        f" permutation test after Holm’s correction, {real} of {len(e.comparisons)}.{some}"
    )


FOREST = Kind(
    "forest",
    "Every pair compared",
    lambda e: len(e.comparisons) > 0 and e.group.plane is None,
    _draw,
    _caption,
)
