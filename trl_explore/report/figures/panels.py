"""Panels of a group on common axes; curves by iteration."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trl_explore.report.curves import Curve
from trl_explore.report.figures import axes
from trl_explore.report.groups import Group
from trl_explore.report.style import INK, Style

T = TypeVar("T")
PANELS_PER_ROW = 2
MARKS = 6
BANDS_UP_TO = 6
"""Most curves that are drawn with bands; more bands would hide each other."""
DEPTH = 1e-6
"""Lower end of a logarithmic axis, as a fraction of the largest value."""


@dataclass(frozen=True)
class PanelNames:
    """A panel: title and names of its configurations."""

    title: str
    names: tuple[str, ...]


def panels_of(group: Group) -> list[PanelNames]:
    """One panel per row of a crossed group; otherwise one untitled panel of all configurations."""
    if group.crossed is None:
        return [PanelNames("", tuple(c.name for c in group.configurations))]
    cells = sorted(group.crossed.cells.items())
    return [
        PanelNames(row, tuple(name for (r, _), name in cells if r == k))
        for k, row in enumerate(group.crossed.rows)
    ]


def draw_panels(
    group: Group,
    draw: Callable[[Axes, T], None],
    panels: Sequence[T],
    x: str,
    y: str,
    *,
    legend: Sequence[tuple[str, Style]] | None = None,
) -> Figure:
    """Draw panels on common axes, two per line, with one legend.

    ``legend`` has its labels and styles; None: the options or configurations of the group.
    """
    entries = list(legend or options_of(group))
    columns = min(PANELS_PER_ROW, len(panels))
    lines = math.ceil(len(panels) / columns)
    figure = axes.new_figure(1.05 + 0.1 * len(entries) + (1.55 if columns > 1 else 2.4) * lines)
    fill_panels(figure, panels, draw, x, y)
    legend_of(figure.axes[0], entries)
    return figure


def fill_panels(
    figure: Figure, panels: Sequence[T], draw: Callable[[Axes, T], None], x: str, y: str
) -> None:
    """Draw panels on common axes of a figure, two per line."""
    columns = min(PANELS_PER_ROW, len(panels))
    grid = figure.subplots(
        math.ceil(len(panels) / columns), columns, sharex=True, sharey=True, squeeze=False
    )
    for k, ax in enumerate(grid.ravel()):
        if k >= len(panels):
            ax.set_axis_off()
            continue
        draw(ax, panels[k])
        ax.set_xlabel("")
        if ax.get_xscale() == "linear":
            axes.few_ticks(ax.xaxis)
        ax.tick_params(labelbottom=k + columns >= len(panels))
    figure.supxlabel(x, fontsize=9)
    figure.supylabel(y, fontsize=9)


def options_of(group: Group) -> list[tuple[str, Style]]:
    """Legend entries of a group: its options, or its configurations."""
    if group.crossed is None:
        return [(group.labels[c.name], group.styles[c.name]) for c in group.configurations]
    looks = {option: group.styles[name] for (_, option), name in group.crossed.cells.items()}
    return [(group.crossed.options[k], looks[k]) for k in sorted(looks)]


def legend_of(ax: Axes, entries: Sequence[tuple[str, Style]]) -> None:
    """Draw a legend above the figure, in columns that fit the labels."""
    columns = 2 if max(len(label) for label, _ in entries) > 12 or len(entries) == 4 else 3
    axes.legend_above(ax, [axes.handle(style, label) for label, style in entries], columns=columns)


def plot_curves(
    ax: Axes,
    curves: Sequence[tuple[Curve, Style]],
    *,
    title: str,
    line: float | None = None,
    limits: tuple[float, float] | None = None,
    log: bool = False,
    from_zero: bool = True,
) -> None:
    """Draw curves by iteration, with bands if they are known.

    ``line`` is the height of a dashed line; without ``limits``, they are :func:`limits_of` the
    curves.
    """
    for k, (curve, style) in enumerate(curves):
        x = curve.iterations
        if curve.low is not None and curve.high is not None and len(curves) <= BANDS_UP_TO:
            ax.fill_between(x, curve.low, curve.high, color=style.color, alpha=0.15, lw=0)
        every = max(1, len(x) // MARKS)
        first = every * (k + 1) // (len(curves) + 1)
        ax.plot(
            x, curve.mean, color=style.color, ls=style.line, marker=style.marker, lw=1.4,
            ms=4, markevery=(min(first, len(x) - 1), every), zorder=3,
        )  # fmt: skip
    if line is not None:
        ax.axhline(line, color=INK, lw=1.0, ls=axes.DASHED, zorder=2)
    ax.set_title(axes.wrapped(title, 28), loc="left", color=INK)
    ax.set_yscale("log" if log else "linear")
    ax.grid()
    shown = [curve for curve, _ in curves]
    ax.set_ylim(*(limits or limits_of(shown, line=line, log=log, from_zero=from_zero)))
    axes.plain_numbers(ax.xaxis)
    axes.plain_numbers(ax.yaxis)


def limits_of(
    curves: Sequence[Curve],
    *,
    line: float | None = None,
    log: bool = False,
    from_zero: bool = True,
) -> tuple[float, float]:
    """Limits of an axis that shows the curves, their bands and the line.

    A linear axis includes zero if ``from_zero``. A logarithmic axis ends at a millionth of the
    largest value.

    >>> limits_of([Curve(np.array([1.0, 2.0]), np.array([3.0, 10.0]))], line=20.0)
    (0.0, 21.0)
    """
    tops = [np.nanmax(c.mean if c.high is None else c.high) for c in curves]
    top = float(max([*tops, line or 0.0]))
    if log:
        positive = [c.mean[c.mean > 0] for c in curves]
        low = min((float(p.min()) for p in positive if len(p)), default=top)
        return max(low, top * DEPTH) / 1.5, top * 1.5
    if not from_zero:
        bottoms = [np.nanmin(c.mean if c.low is None else c.low) for c in curves]
        low = float(min([*bottoms, top if line is None else line]))
        margin = max(0.05 * (top - low), 0.005 * abs(top))
        return low - margin, top + margin
    low = min([0.0, *(float(np.nanmin(c.mean)) for c in curves)])
    return 1.05 * low, (1.05 * top) or 1.0
