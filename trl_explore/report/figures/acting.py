"""The same weights with and without exploration: one row per strategy and gradient."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from trl_explore.report.decomposition import Acting, Decomposition
from trl_explore.report.figures.axes import (
    legend_above,
    line_count,
    new_figure,
    plain_numbers,
    wrapped,
)
from trl_explore.report.style import GRID, INK, MUTED, PAPER, Style, styles
from trl_explore.statistics.estimates import LEVEL

TITLE = "What agents do, and what they have learned"


@dataclass(frozen=True)
class Row:
    """One configuration; ``first`` if it begins a block."""

    label: str
    acting: Acting
    style: Style
    first: bool


def rows_of(found: Sequence[Decomposition]) -> list[Row]:
    """The rows of one environment: every strategy with its cells, and softmax last."""
    rows = []
    for d, style in zip(found, styles([d.name for d in found]), strict=True):
        named = {
            "plain": d.strategy,
            "corrected": f"{d.strategy}, corrected",
            "assumed": f"softmax, biased as {d.strategy}",
        }
        here = [(label, d.acting[cell]) for cell, label in named.items() if cell in d.acting]
        rows += [Row(label, a, style, k == 0) for k, (label, a) in enumerate(here)]
    (softmax,) = styles(["softmax"])
    last = next((a for d in found if (a := d.acting.get("reference"))), None)
    return rows + ([Row("softmax", last, softmax, True)] if last else [])


def plot_acting(ax: Axes, rows: Sequence[Row], quantity: str) -> None:
    """Draw both scores of every row with their intervals, and a line between them."""
    for y, row in enumerate(rows):
        color, mark = row.style.color, row.style.marker
        behaved, learned = row.acting.behaved, row.acting.learned
        ax.plot([behaved.value, learned.value], [y, y], color=color, lw=1.1, zorder=2)
        for e, face in ((behaved, PAPER), (learned, color)):
            if np.isfinite([e.low, e.high]).all():
                ax.plot([e.low, e.high], [y, y], color=color, lw=3.4, alpha=0.35, zorder=1)
            ax.plot([e.value], [y], ls="", marker=mark, mfc=face, mec=color, ms=6, zorder=3)
        if row.first and y:
            ax.axhline(y - 0.5, color=GRID, lw=0.8, zorder=0)
    ax.set_yticks(range(len(rows)), [wrapped(row.label, 24) for row in rows])
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
    ax.grid(axis="x")
    ax.set_xlabel(quantity, color=INK)
    plain_numbers(ax.xaxis)
    handles = [
        Line2D([], [], ls="", color=MUTED, marker="o", mfc=face, ms=6, label=label)
        for label, face in (("while it explores", PAPER), ("without exploration", MUTED))
    ]
    legend_above(ax, handles, columns=2)


def draw_acting(found: Sequence[Decomposition]) -> Figure:
    """The figure of one environment."""
    rows = rows_of(found)
    figure = new_figure(1.1 + sum(0.13 + 0.16 * line_count(row.label, 24) for row in rows))
    plot_acting(figure.subplots(), rows, "mean score over training")
    return figure


def caption_of(found: Sequence[Decomposition]) -> str:
    """What the figure shows."""
    return (
        f"{found[0].environment}. Hollow: mean score of the training episodes, in which the agent"
        " explores. Filled: mean score of the same weights, played without exploration in episodes"
        " of their own. Both are means over the whole training and over trials; the distance"
        f" between them is lost to acting. Shaded: {100 * LEVEL:g} % intervals. “Corrected”: with"
        " the per-step ratio; “biased as”: softmax acts, and its gradient has the bias of the"
        " other strategy."
    )
