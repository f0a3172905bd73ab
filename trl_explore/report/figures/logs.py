"""Figures of the page on runs of other programs: curves, survival, performance profiles."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.axes import Axes
from scipy import stats

from trl_explore.logs.measures import Task, profile
from trl_explore.report.curves import Curve
from trl_explore.report.figures import Picture
from trl_explore.report.figures.axes import handle, legend_above, new_figure, plain_numbers
from trl_explore.report.figures.panels import BANDS_UP_TO, plot_curves
from trl_explore.report.figures.survival import Row, plot_survival
from trl_explore.report.image_files import drawn_files
from trl_explore.report.style import Style
from trl_explore.statistics.estimates import LEVEL
from trl_explore.statistics.survival import kaplan_meier

Looks = Mapping[str, Style]


def task_figures(task: Task, id: str, looks: Looks) -> list[Picture]:
    """Every figure of one environment."""
    many = len(task.configurations) > BANDS_UP_TO
    bands = "" if many else f" Bands: {100 * LEVEL:g} % intervals, at each step on its own."
    drawn: list[tuple[str, str, str, Callable[[Axes, Task, Looks], None]]] = [
        ("curves", "Learning curves",
         f"Mean score of the runs by step, smoothed as above.{bands}", _draw_curves),
        ("survival", f"Runs that have not exceeded {task.threshold:g}" if task.threshold else "",
         "Kaplan–Meier. A curve that falls earlier and further is better. Runs that were cut off"
         f" are censored where they ended.{bands}", _draw_survival),
        ("profile", "Performance profiles",
         "Share of runs with a final score above the value on the axis; higher is better."
         f"{bands.replace('step', 'score')}", _draw_profile),
    ]  # fmt: skip
    if task.threshold is None:
        del drawn[1]
    return [_picture(f"{id}-{name}", title, caption, task, looks, draw)
            for name, title, caption, draw in drawn]  # fmt: skip


def _picture(
    id: str, title: str, caption: str, task: Task, looks: Looks,
    draw: Callable[[Axes, Task, Looks], None],
) -> Picture:  # fmt: skip
    names = [c.name for c in task.configurations]
    columns = 2 if max(map(len, names)) < 28 else 1
    figure = new_figure(2.8 + 0.17 * -(-len(names) // columns))
    ax = figure.subplots()
    draw(ax, task, looks)
    ax.grid(True)
    plain_numbers(ax.xaxis)
    legend_above(ax, [handle(looks[name], name[:40]) for name in names], columns)
    return Picture(id, title, caption, f"{title} of {', '.join(names)}", **drawn_files(figure))


def _draw_curves(ax: Axes, task: Task, looks: Looks) -> None:
    curves = []
    for c in task.configurations:
        known = c.curves[np.isfinite(c.curves[:, 0])]
        if not (n := len(known)):
            continue
        mean, half = known.mean(0), None
        if n > 1:
            half = stats.t.ppf((1 + LEVEL) / 2, n - 1) * known.std(0, ddof=1) / np.sqrt(n)
        low, high = (None, None) if half is None else (mean - half, mean + half)
        curves.append((Curve(c.grid, mean, low, high), looks[c.name]))
    if curves:
        plot_curves(ax, curves, title="", line=task.threshold, from_zero=False)
    ax.set_xlabel(task.configurations[0].runs[0].step)
    ax.set_ylabel("score")


def _draw_survival(ax: Axes, task: Task, looks: Looks) -> None:
    rows = [
        Row(c.name, kaplan_meier(c.time, c.passed), c.time, looks[c.name])
        for c in task.configurations
    ]
    step = task.configurations[0].runs[0].step
    plot_survival(ax, rows, time=step, title="", horizon=task.horizon)


def _draw_profile(ax: Axes, task: Task, looks: Looks) -> None:
    for c in task.configurations:
        values, look = np.sort(c.final[np.isfinite(c.final)]), looks[c.name]
        if not len(values):
            continue
        room = 0.04 * (np.ptp(values) or abs(values[0]) or 1.0)
        scores = np.unique(np.concatenate([[values[0] - room], values, [values[-1] + room]]))
        shares = profile(values, scores)
        ax.step(scores, [s.value for s in shares], where="post", color=look.color, ls=look.line)
        ax.plot(values, [s.value for s in profile(values, values)], ls="", color=look.color,
                marker=look.marker)  # fmt: skip
        if len(task.configurations) <= BANDS_UP_TO:
            ax.fill_between(scores, [s.low for s in shares], [s.high for s in shares],
                            step="post", color=look.color, alpha=0.13, lw=0)  # fmt: skip
    ax.set_xlabel("final score")
    ax.set_ylim(-0.02, 1.02)
    ax.set_yticks(np.linspace(0, 1, 5), ["0 %", "25 %", "50 %", "75 %", "100 %"])
