"""Options of a group in blocks of rows: how many trials pass, and after how many iterations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from trl_explore.report.figures.axes import plain_numbers, wrapped
from trl_explore.report.style import GRID, INK, Style
from trl_explore.statistics.estimates import Estimate

GAP = 0.9
"""Space between blocks, in rows."""


@dataclass(frozen=True)
class Dot:
    """One configuration: its block, its place in it, an estimate, and its look."""

    block: int
    place: int
    estimate: Estimate
    style: Style


def height(block: int, place: int, options: int) -> float:
    """Where a configuration stands, from top to bottom.

    >>> height(1, 0, 4)
    4.9
    """
    return block * (options + GAP) + place


def plot_effects(
    ax: Axes, dots: Sequence[Dot], blocks: Sequence[str], options: int, *, quantity: str
) -> None:
    """Draw each estimate with its interval, block by block.

    Args:
        ax: empty axes.
        dots: what to draw.
        blocks: names of the blocks, from top to bottom.
        options: places in a block.
        quantity: name and unit of the horizontal axis.

    """
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
