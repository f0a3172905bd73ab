"""Several curves with their bands on one panel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from trl_explore.report.figures.axes import plain_numbers, wrapped
from trl_explore.report.figures.learning import Row
from trl_explore.report.style import INK

MARKS = 6
BANDS_UP_TO = 6
DEPTH = 1e-6


def plot_curves(
    ax: Axes,
    rows: Sequence[Row],
    *,
    title: str,
    line: float | None = None,
    limits: tuple[float, float] | None = None,
    log: bool = False,
) -> None:
    """Draw curves by iteration, each with its band where it has one.

    Args:
        ax: empty axes.
        rows: curves in the order of the legend.
        title: of the panel.
        line: height of a dashed line.
        limits: of the vertical axis; None: those of :func:`limits_of`.
        log: whether the vertical axis is logarithmic.

    """
    for k, row in enumerate(rows):
        x, style = row.iterations, row.style
        if row.low is not None and row.high is not None and len(rows) <= BANDS_UP_TO:
            ax.fill_between(x, row.low, row.high, color=style.color, alpha=0.15, lw=0)
        every = max(1, len(x) // MARKS)
        first = every * (k + 1) // (len(rows) + 1)
        ax.plot(
            x, row.mean, color=style.color, ls=style.line, marker=style.marker, lw=1.4,
            ms=4, markevery=(min(first, len(x) - 1), every), zorder=3,
        )  # fmt: skip
    if line is not None:
        ax.axhline(line, color=INK, lw=1.0, ls=(0, (4, 3)), zorder=2)
    ax.set_title(wrapped(title, 28), loc="left", color=INK)
    ax.set_yscale("log" if log else "linear")
    ax.grid()
    ax.set_ylim(*(limits or limits_of(rows, line=line, log=log)))
    plain_numbers(ax.xaxis)
    plain_numbers(ax.yaxis)


def limits_of(
    rows: Sequence[Row],
    *,
    line: float | None = None,
    log: bool = False,
    from_zero: bool = True,
) -> tuple[float, float]:
    """Of an axis that holds the curves, their bands and the line, and zero if it is linear.

    A logarithmic one holds the curves down to a millionth of the largest value.

    >>> from trl_explore.report.style import OPTIONS
    >>> row = Row("", np.array([1.0, 2.0]), np.array([3.0, 10.0]), None, None, OPTIONS[0])
    >>> limits_of([row], line=20.0)
    (0.0, 21.0)
    """
    tops = [np.nanmax(row.mean if row.high is None else row.high) for row in rows]
    top = float(max([*tops, line or 0.0]))
    if log:
        positive = [row.mean[row.mean > 0] for row in rows]
        low = min((float(p.min()) for p in positive if len(p)), default=top)
        return max(low, top * DEPTH) / 1.5, top * 1.5
    if not from_zero:
        bottoms = [np.nanmin(row.mean if row.low is None else row.low) for row in rows]
        low = float(min([*bottoms, top if line is None else line]))
        margin = max(0.05 * (top - low), 0.005 * abs(top))
        return low - margin, top + margin
    low = min([0.0, *(float(np.nanmin(row.mean)) for row in rows)])
    return 1.05 * low, (1.05 * top) or 1.0
