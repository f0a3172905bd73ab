"""Kaplan-Meier curves, and under them how many trials are still at risk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from trl_explore.report.figures.axes import plain_numbers, spans_much, wrapped
from trl_explore.report.style import INK, MUTED, Style
from trl_explore.statistics.survival import SurvivalCurve, number_at_risk

MARKS = 9
BANDS_UP_TO = 6
"""Curves with bands; those of more would only hide each other."""


@dataclass(frozen=True, eq=False)
class Row:
    """One configuration: its curve, and the durations [n] that it was made of."""

    label: str
    curve: SurvivalCurve
    durations: NDArray[np.float64]
    style: Style


def plot_survival(
    ax: Axes, rows: Sequence[Row], *, time: str, horizon: float | None = None
) -> None:
    """Draw Ŝ(t), the share of trials that have not converged by t, with pointwise bands.

    Args:
        ax: empty axes.
        rows: configurations.
        time: name and unit of the horizontal axis.
        horizon: where the axis ends; None: at the last time of any row.

    """
    end = horizon or max(float(row.curve.times[-1]) for row in rows)
    log = spans_much([row.durations for row in rows])
    start = 0.8 * min(row.durations.min() for row in rows) if log else 0.0
    for k, row in enumerate(rows):
        curve, style = row.curve, row.style
        times = np.append(curve.times, max(end, curve.times[-1]))
        if len(rows) <= BANDS_UP_TO:
            low, high = np.append(curve.low, curve.low[-1]), np.append(curve.high, curve.high[-1])
            ax.fill_between(times, low, high, step="post", color=style.color, alpha=0.13, lw=0)
        heights = np.append(curve.survival, curve.survival[-1])
        ax.step(times, heights, where="post", color=style.color, ls=style.line)
        share = (np.arange(MARKS) + (k + 0.5) / len(rows)) / MARKS
        marks = start * (end / start) ** share if log else end * share
        seen = marks[marks <= curve.times[-1]]
        ax.plot(seen, curve.at(seen), ls="", marker=style.marker, color=style.color, ms=5)
    ax.set_xscale("log" if log else "linear")
    ax.set_xlim(start, end * (1.05 if log else 1.02))
    ax.set_ylim(-0.02, 1.02)
    ax.set_yticks(np.linspace(0, 1, 5), ["0 %", "25 %", "50 %", "75 %", "100 %"])
    ax.set_title("trials not yet converged", loc="left", color=INK)
    ax.set_xlabel(time + (" (logarithmic)" if log else ""))
    ax.grid()
    plain_numbers(ax.xaxis)


def plot_survival_panel(ax: Axes, rows: Sequence[Row], *, title: str, horizon: float) -> None:
    """The same as one of several panels: its title is its own, the legend that of the figure.

    Args:
        ax: empty axes.
        rows: configurations.
        title: of the panel.
        horizon: where the axis ends.

    """
    plot_survival(ax, rows, time="", horizon=horizon)
    ax.set_title(wrapped(title, 28), loc="left", color=INK)


def plot_numbers_at_risk(ax: Axes, rows: Sequence[Row], times: Sequence[float]) -> None:
    """Write how many trials are still at risk; the label of each row is the legend.

    Args:
        ax: empty axes that share the horizontal axis of the curves.
        rows: configurations, from top to bottom.
        times: the ticks of the curves, in their unit.

    """
    ax.set_ylim(len(rows) - 0.5, -1.3)
    ax.set_axis_off()
    over = ax.get_yaxis_transform()
    ax.text(-0.06, -1, "still learning", transform=over, ha="right", va="center", color=MUTED)
    for y, row in enumerate(rows):
        color, mark = row.style.color, row.style.marker
        ax.plot(
            [-0.15, -0.105, -0.06], [y] * 3, transform=over, clip_on=False, color=color,
            ls=row.style.line, marker=mark, markevery=[1],
        )  # fmt: skip
        ax.text(
            -0.17, y, wrapped(row.label), transform=over, ha="right", va="center", color=INK,
            linespacing=1.0,
        )  # fmt: skip
        for time, count in zip(times, number_at_risk(row.durations, times), strict=True):
            ax.text(time, y, f"{count}", ha="center", va="center", fontsize=8, color=INK)
