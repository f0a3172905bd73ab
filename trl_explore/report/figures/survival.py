"""Kaplan-Meier curves with the numbers of trials at risk below them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures import axes
from trl_explore.report.figures.panels import BANDS_UP_TO, PanelNames, draw_panels, panels_of
from trl_explore.report.style import INK, MUTED, Style
from trl_explore.statistics.outcomes import convergence_times
from trl_explore.statistics.survival import SurvivalCurve, kaplan_meier, number_at_risk

MARKS = 9


@dataclass(frozen=True, eq=False)
class Row:
    """One configuration: its curve, and the durations [n] that the curve is estimated from."""

    label: str
    curve: SurvivalCurve
    durations: NDArray[np.float64]
    style: Style


def plot_survival(
    ax: Axes,
    rows: Sequence[Row],
    *,
    time: str,
    title: str = "trials not yet converged",
    horizon: float | None = None,
) -> None:
    """Draw Ŝ(t), the share of trials that have not converged by t, with pointwise bands.

    The time axis ends at ``horizon``, or at the last time of any row if that is None.
    """
    end = horizon or max(float(row.curve.times[-1]) for row in rows)
    log = axes.spans_much([row.durations for row in rows])
    start = 0.8 * min(row.durations.min() for row in rows) if log else 0.0
    for k, row in enumerate(rows):
        curve, style = row.curve, row.style
        # After the last trial was censored, nothing is known.
        last = max(end, curve.times[-1]) if curve.survival[-1] == 0 else curve.times[-1]
        times = np.append(curve.times, last)
        heights, low, high = (np.append(y, y[-1]) for y in (curve.survival, curve.low, curve.high))
        if len(rows) <= BANDS_UP_TO:
            ax.fill_between(times, low, high, step="post", color=style.color, alpha=0.13, lw=0)
        ax.step(times, heights, where="post", color=style.color, ls=style.line)
        share = (np.arange(MARKS) + (k + 0.5) / len(rows)) / MARKS
        marks = start * (end / start) ** share if log else end * share
        seen = marks[marks <= curve.times[-1]]
        ax.plot(seen, curve.at(seen), ls="", marker=style.marker, color=style.color, ms=5)
    ax.set_xscale("log" if log else "linear")
    ax.set_xlim(start, end * (1.05 if log else 1.02))
    ax.set_ylim(-0.02, 1.02)
    ax.set_yticks(np.linspace(0, 1, 5), ["0 %", "25 %", "50 %", "75 %", "100 %"])
    ax.set_title(axes.wrapped(title, 28), loc="left", color=INK)
    ax.set_xlabel(time + (" (logarithmic)" if log else ""))
    ax.grid()
    axes.plain_numbers(ax.xaxis)


def plot_numbers_at_risk(ax: Axes, rows: Sequence[Row], times: Sequence[float]) -> None:
    """Write the numbers of trials at risk; the row labels are the legend.

    The horizontal axis is that of the curves, with ticks at ``times``.
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
            -0.17, y, axes.wrapped(row.label), transform=over, ha="right", va="center", color=INK,
            linespacing=1.0,
        )  # fmt: skip
        for time, count in zip(times, number_at_risk(row.durations, times), strict=True):
            ax.text(time, y, f"{count}", ha="center", va="center", fontsize=8, color=INK)


def draw_survival(e: GroupEvidence, unit: str) -> Figure:
    """Kaplan-Meier curves in iterations or frames, with the numbers at risk below them."""
    rows = _rows(e, [c.name for c in e.group.configurations], unit)
    below = 0.19 * (len(rows) * max(0.8 * axes.line_count(row.label) + 0.2 for row in rows) + 1.2)
    figure = axes.new_figure(3.1 + below)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.6, below])
    upper.tick_params(labelbottom=True)
    plot_survival(upper, rows, time=unit, title=_quantity(e))
    low, high = upper.get_xlim()
    plot_numbers_at_risk(lower, rows, [t for t in upper.get_xticks() if low <= t <= high])
    return figure


def _rows(e: GroupEvidence, names: Sequence[str], unit: str) -> list[Row]:
    group, rows = e.group, []
    end = max(int(c.frames.max()) for c in group.configurations)
    by_name = {c.name: c for c in group.configurations}
    for name in names:
        durations, converged = convergence_times(by_name[name], unit)
        if unit == "frames":  # failed trials stay at risk until the end of the common axis
            durations = np.where(converged, durations, end)
        curve = kaplan_meier(durations, converged, level=e.level)
        rows.append(Row(group.labels[name], curve, durations, group.styles[name]))
    return rows


def _draw_panels(e: GroupEvidence) -> Figure:
    end = float(max(int(c.durations.max()) for c in e.group.configurations))

    def draw(ax: Axes, panel: PanelNames) -> None:
        rows = _rows(e, panel.names, "iterations")
        plot_survival(ax, rows, time="", title=panel.title, horizon=end)

    return draw_panels(e.group, draw, panels_of(e.group), "iterations", _quantity(e))


def _quantity(e: GroupEvidence) -> str:
    learned = e.group.did == "learned"
    return "trials that have not learned" if learned else "trials not yet converged"


SHARE, LEARNED = "How many trials are still learning", "How many trials have not learned"
BY_LEARNING = (
    "The same trials, judged by what they have learned: the policy is played without exploration."
)


@axes.kind("survival", SHARE, axes.plain, hero=True)
def curves(e: GroupEvidence) -> axes.Shown:
    """The curves of all configurations in iterations."""
    many = len(e.group.configurations) > BANDS_UP_TO
    bands = "" if many else f" Bands: {100 * e.level:g} % intervals."
    return draw_survival(e, "iterations"), (
        f"Share of {_quantity(e)} (Kaplan–Meier). A curve that falls earlier and further is"
        f" better. Trials that had not {e.group.did} by {e.group.cap:,} iterations were stopped"
        f" there. {axes.passed(e)}{bands} Below: how many of {axes.trials(e)} trials are still"
        " learning."
    )


@axes.kind("survival-panels", SHARE, axes.crossed)
def panels(e: GroupEvidence) -> axes.Shown:
    """One panel per row of a crossed group."""
    return _draw_panels(e), (
        "Share of trials that have not converged (Kaplan–Meier). Trials that had not passed by the"
        f" cap of {e.group.cap:,} iterations were stopped there."
        f" Bands: {100 * e.level:g} % intervals."
    )


@axes.kind("survival-learned", LEARNED, lambda e: axes.plain(e) and e.learned is not None)
def learned(e: GroupEvidence) -> axes.Shown:
    """The same curves, judged by what was learned."""
    assert e.learned is not None
    counts = axes.each(e.learned, lambda c: f"{int(c.converged.sum())} of {len(c)}")
    return draw_survival(e.learned, "iterations"), (
        f"{BY_LEARNING} Share of trials that have not learned (Kaplan–Meier)."
        f" Learned{axes.by(e.learned)}: {counts}."
    )


@axes.kind("survival-learned-panels", LEARNED, lambda e: axes.crossed(e) and e.learned is not None)
def learned_panels(e: GroupEvidence) -> axes.Shown:
    """The same panels, judged by what was learned."""
    assert e.learned is not None
    return _draw_panels(e.learned), f"{BY_LEARNING} Bands: {100 * e.level:g} % intervals."


@axes.kind("survival-frames", f"{SHARE}, in frames", axes.whole_study)
def frames(e: GroupEvidence) -> axes.Shown:
    """The curves of all configurations in frames."""
    return draw_survival(e, "frames"), (
        "The same curves by environment steps (frames), which do not depend on the machine. Failed"
        " trials count as still learning until the end of the axis. They often have short episodes"
        " and reach the cap after few frames, so removing them there would make poor strategies"
        " look good."
    )
