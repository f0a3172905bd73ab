"""Pass rates and mean iterations of options, in blocks of rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures.axes import new_figure, plain_numbers, wrapped
from trl_explore.report.figures.kind import Kind, crossed, trials
from trl_explore.report.figures.panels import legend_of, options_of
from trl_explore.report.style import GRID, INK, Style
from trl_explore.statistics.estimates import LEVEL, Estimate

GAP = 0.9
"""Space between blocks, in rows."""


@dataclass(frozen=True)
class Dot:
    """One configuration: its block, its place in the block, its estimate and its style."""

    block: int
    place: int
    estimate: Estimate
    style: Style


def height(block: int, place: int, options: int) -> float:
    """Vertical position of a configuration, from top to bottom.

    >>> height(1, 0, 4)
    4.9
    """
    return block * (options + GAP) + place


def plot_effects(
    ax: Axes, dots: Sequence[Dot], blocks: Sequence[str], options: int, *, quantity: str
) -> None:
    """Draw each estimate with its interval, in named blocks with one row per option."""
    for dot in dots:
        y, e = height(dot.block, dot.place, options), dot.estimate
        if np.isfinite([e.low, e.high]).all():
            ax.plot([e.low, e.high], [y, y], color=dot.style.color, lw=1.6, zorder=2)
        ax.plot(
            [e.value], [y], ls="", marker=dot.style.marker, color=dot.style.color, ms=5.5, zorder=3
        )
    middles = [height(b, 0, options) + (options - 1) / 2 for b in range(len(blocks))]
    ax.set_yticks(middles, [wrapped(block, 18) for block in blocks])
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(height(len(blocks) - 1, options - 1, options) + 0.8, -0.8)
    for block in range(1, len(blocks)):
        ax.axhline(height(block, 0, options) - (GAP + 1) / 2, color=GRID, lw=0.8, zorder=0)
    ax.spines["left"].set_visible(False)
    ax.grid(axis="x")
    ax.set_xlabel(quantity, color=INK)
    plain_numbers(ax.xaxis)


def _draw(e: GroupEvidence) -> Figure:
    """Draw pass rate and mean iterations of a crossed group."""
    group, layout = e.group, e.group.crossed
    assert layout is not None
    rates, means = [], []
    for (row, option), name in layout.cells.items():
        summary, style = e.summary(name), group.styles[name]
        rate = summary.pass_rate
        percent = Estimate(100 * rate.value, 100 * rate.low, 100 * rate.high)
        rates.append(Dot(row, option, percent, style))
        means.append(Dot(row, option, summary.restricted_mean, style))
    rows, n = layout.rows, len(layout.options)
    figure = new_figure(1.25 + 0.155 * height(len(rows), 0, n))
    left, right = figure.subplots(1, 2, sharey=True)
    plot_effects(left, rates, rows, n, quantity="trials that pass, %")
    plot_effects(right, means, rows, n, quantity="mean iterations")
    right.tick_params(axis="y", labelleft=False)
    left.set_xlim(-4, 104)
    left.set_xticks([0, 25, 50, 75, 100])
    right.xaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 2.5, 5, 10]))
    right.set_xlim(0, 1.04 * group.cap)
    legend_of(left, options_of(group))
    return figure


def _caption(e: GroupEvidence) -> str:
    layout = e.group.crossed
    assert layout is not None
    return (
        f"Left: share of {trials(e)} trials that pass. Right: mean number of iterations; failed"
        f" trials count as {e.group.cap:,}. Bars: {100 * LEVEL:g} % intervals (left: Wilson;"
        f" right: MOVER). Circles: {layout.options[0]}."
    )


EFFECTS = Kind("effects", "What the options do", crossed, _draw, _caption, hero=True, why=True)
