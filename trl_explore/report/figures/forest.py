"""Forest plot: the difference in iterations of each pair of configurations."""

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
from trl_explore.report.numbers import negated
from trl_explore.report.style import GRID, INK, MUTED, PAPER, Style
from trl_explore.statistics.comparisons import Comparison
from trl_explore.statistics.estimates import LEVEL, Estimate

MOST_PAIRS = 15
"""Most pairs in a forest plot; if there are more, only those with the fastest are shown."""


@dataclass(frozen=True)
class Row:
    """One pair; ``difference`` is how many iterations fewer the first needs."""

    first: str
    second: str
    difference: Estimate
    told_apart: bool
    style: Style


def pair_label(row: Row) -> str:
    """The label of a row, "A vs. B", in two lines if it is long."""
    first, second = wrapped(row.first, 36, 1), wrapped(row.second, 36, 1)
    return f"{first} vs. {second}" if len(first) + len(second) <= 26 else f"{first}\nvs. {second}"


def plot_forest(ax: Axes, rows: Sequence[Row]) -> None:
    """Draw each pair's difference with its interval; hollow if it is not significant."""
    for y, row in enumerate(rows):
        e = row.difference
        if np.isfinite([e.low, e.high]).all():
            ax.plot([e.low, e.high], [y, y], color=row.style.color, lw=1.7, zorder=2)
        ax.plot(
            [e.value], [y], marker=row.style.marker, ms=6, mec=row.style.color,
            mfc=row.style.color if row.told_apart else PAPER, zorder=3,
            label="significant" if row.told_apart else "not significant",
        )  # fmt: skip
    ax.axvline(0, color=INK, lw=1.0)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.set_yticks(range(len(rows)), [pair_label(row) for row in rows])
    ax.tick_params(axis="y", length=0, labelsize=8.5)
    ax.spines["left"].set_visible(False)
    ax.grid(axis="x")
    ax.grid(axis="y", color=GRID, lw=0.4)
    ax.set_xlabel("iterations that the first saves")
    plain_numbers(ax.xaxis)
    entries = [("significant", True, MUTED), ("not significant", False, PAPER)]
    handles = [
        Line2D([], [], color=MUTED, marker="o", mfc=face, label=label)
        for label, kind, face in entries
        if any(row.told_apart == kind for row in rows)
    ]
    legend_above(ax, handles, columns=2)


def oriented(comparison: Comparison) -> tuple[str, str, Estimate]:
    """Faster and slower configuration of a pair, and the iterations that the faster one saves."""
    e = comparison.difference
    if e.value > 0:
        return comparison.b, comparison.a, e
    return comparison.a, comparison.b, negated(e)


def _shown(e: GroupEvidence) -> list[Comparison]:
    """All comparisons, or those with the fastest configuration."""
    if len(e.comparisons) <= MOST_PAIRS or e.group.crossed is not None:
        return e.comparisons
    best = min(e.group.configurations, key=lambda c: float(c.durations.mean())).name
    return [c for c in e.comparisons if best in (c.a, c.b)]


def _draw(e: GroupEvidence) -> Figure:
    """Draw the pairs, the largest difference on top."""
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
        f" Only the {len(shown)} pairs with the fastest configuration are shown; the table has all."
        if len(shown) < len(e.comparisons)
        else ""
    )
    return (
        "Mean number of iterations (restricted to the cap) that the first of a pair saves compared"
        f" with the second, with {100 * LEVEL:g} % interval. Filled: significant by interval and"
        f" permutation test after Holm’s correction, {real} of {len(e.comparisons)} pairs.{some}"
    )


FOREST = Kind(
    "forest",
    "Every pair compared",
    lambda e: len(e.comparisons) > 0 and e.group.plane is None and not e.group.sized,
    _draw,
    _caption,
)
