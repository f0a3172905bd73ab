"""Forest plot: how many iterations one configuration saves against another, for all pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from trl_explore.report.figures.axes import legend_above, plain_numbers, wrapped
from trl_explore.report.style import GRID, INK, MUTED, PAPER, Style
from trl_explore.statistics.estimates import Estimate


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


def plot_forest(ax: Axes, rows: Sequence[Row], *, unit: str) -> None:
    """Draw each pair's difference with its interval; hollow where it may be chance.

    Args:
        ax: empty axes.
        rows: pairs, from top to bottom.
        unit: of the differences.

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
    ax.set_xlabel(f"the first needs fewer by ({unit})")
    plain_numbers(ax.xaxis)
    entries = [("told apart", True, MUTED), ("may be chance", False, PAPER)]
    handles = [
        Line2D([], [], color=MUTED, marker="o", mfc=face, label=label)
        for label, kind, face in entries
        if any(row.told_apart == kind for row in rows)
    ]
    legend_above(ax, handles, columns=2)
