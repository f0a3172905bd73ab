"""Learning curves: mean score over iterations, with the middle half of the trials as a band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from trl_explore.report.figures.axes import plain_numbers, wrapped
from trl_explore.report.style import INK, Style

MARKS = 6


@dataclass(frozen=True, eq=False)
class Row:
    """One configuration: ``mean`` and, where known, ``low`` and ``high`` by ``iterations`` [k]."""

    label: str
    iterations: NDArray[np.float64]
    mean: NDArray[np.float64]
    low: NDArray[np.float64] | None
    high: NDArray[np.float64] | None
    style: Style


def plot_learning(
    ax: Axes, row: Row, *, others: Sequence[Row] = (), threshold: float | None = None
) -> None:
    """Draw one learning curve with its band, and the means of the others thinly behind it.

    Args:
        ax: empty axes.
        row: the configuration.
        others: further ones, for comparison by eye.
        threshold: score above which a trial has passed.

    """
    for other in others:
        ax.plot(other.iterations, other.mean, color=other.style.color, lw=0.8, alpha=0.45, zorder=1)
    if row.low is not None and row.high is not None:
        ax.fill_between(row.iterations, row.low, row.high, color=row.style.color, alpha=0.2, lw=0)
    every = max(1, len(row.iterations) // MARKS)
    ax.plot(
        row.iterations, row.mean, color=row.style.color, ls=row.style.line,
        marker=row.style.marker, markevery=(every // 2, every), zorder=3,
    )  # fmt: skip
    if threshold is not None:
        ax.axhline(threshold, color=INK, lw=1.0, ls=(0, (4, 3)), zorder=2)
    ax.set_title(wrapped(row.label, 28), loc="left", color=INK)
    ax.grid()
    ax.set_ylim(bottom=min(0.0, *(float(np.nanmin(r.mean)) for r in (row, *others))))
    plain_numbers(ax.xaxis)
    plain_numbers(ax.yaxis)
