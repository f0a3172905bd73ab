"""Figures of the page on runs of other programs: curves, survival, performance profiles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from scipy import stats

from trl_explore.logs.measures import Configuration, Task, profile
from trl_explore.report.figures import Picture
from trl_explore.report.figures.axes import handle, legend_above, new_figure, plain_numbers
from trl_explore.report.style import INK, Style, drawn_files
from trl_explore.statistics.estimates import LEVEL
from trl_explore.statistics.survival import kaplan_meier


def task_figures(task: Task, id: str, looks: dict[str, Style]) -> list[Picture]:
    """Every figure of one environment."""
    bands = f"Bands: {100 * LEVEL:g} % intervals, at each step on its own."
    drawn = [
        ("curves", "Learning curves",
         f"Mean score of the runs by step, smoothed as above. {bands}", _draw_curves),
    ]  # fmt: skip
    if task.threshold is not None:
        drawn.append((
            "survival", f"Runs that have not exceeded {task.threshold:g}",
            "Kaplan–Meier. A curve that falls earlier and further is better. Runs that were cut off"
            f" are censored where they ended. {bands}", _draw_survival,
        ))  # fmt: skip
    drawn.append((
        "profile", "Performance profiles",
        f"Share of runs with a final score above the value on the axis; higher is better. {bands}",
        _draw_profile,
    ))  # fmt: skip
    return [_picture(f"{id}-{name}", title, text, task, looks, draw)
            for name, title, text, draw in drawn]  # fmt: skip


def _picture(
    id: str, title: str, caption: str, task: Task, looks: dict[str, Style],
    draw: Callable[[Axes, Configuration, Style], None],
) -> Picture:  # fmt: skip
    rows = (len(task.configurations) + 1) // 2
    figure = new_figure(2.8 + 0.17 * rows)
    ax = figure.subplots()
    for c in task.configurations:
        draw(ax, c, looks[c.name])
    steps = task.configurations[0].runs[0].step
    ax.set_xlabel("final score" if draw is _draw_profile else steps)
    if draw is _draw_curves:
        ax.set_ylabel("score")
        if task.threshold is not None:
            ax.axhline(task.threshold, color=INK, lw=0.8, ls=":")
    else:
        ax.set_ylim(-0.02, 1.02)
        ax.set_yticks(np.linspace(0, 1, 5), ["0 %", "25 %", "50 %", "75 %", "100 %"])
    ax.grid()
    plain_numbers(ax.xaxis)
    entries = [handle(looks[c.name], c.name[:40]) for c in task.configurations]
    legend_above(ax, entries, 2 if max(len(c.name) for c in task.configurations) < 28 else 1)
    alt = f"{title} of {', '.join(c.name for c in task.configurations)}"
    return Picture(id, title, caption, alt, **drawn_files(figure))


def _draw_curves(ax: Axes, c: Configuration, look: Style) -> None:
    known = c.curves[np.isfinite(c.curves[:, 0])]
    if not len(known):
        return
    mean, n = known.mean(0), len(known)
    ax.plot(c.grid, mean, color=look.color, ls=look.line, marker=look.marker, markevery=50)
    if n > 1:
        half = stats.t.ppf((1 + LEVEL) / 2, n - 1) * known.std(0, ddof=1) / np.sqrt(n)
        ax.fill_between(c.grid, mean - half, mean + half, color=look.color, alpha=0.13, lw=0)


def _draw_survival(ax: Axes, c: Configuration, look: Style) -> None:
    curve, end = kaplan_meier(c.time, c.passed), float(c.grid[-1])
    times, heights = np.append(curve.times, end), np.append(curve.survival, curve.survival[-1])
    low, high = np.append(curve.low, curve.low[-1]), np.append(curve.high, curve.high[-1])
    if curve.times[-1] < end:  # unknown after the last run was cut off
        times, heights, low, high = curve.times, curve.survival, curve.low, curve.high
    ax.fill_between(times, low, high, step="post", color=look.color, alpha=0.13, lw=0)
    ax.step(times, heights, where="post", color=look.color, ls=look.line)
    marks = np.linspace(0, times[-1], 8)
    ax.plot(marks, curve.at(marks), ls="", color=look.color, marker=look.marker)


def _draw_profile(ax: Axes, c: Configuration, look: Style) -> None:
    values = np.sort(c.final[np.isfinite(c.final)])
    if not len(values):
        return
    room = 0.04 * (np.ptp(values) or abs(values[0]) or 1.0)
    scores = np.unique(np.concatenate([[values[0] - room], values, [values[-1] + room]]))
    shares = profile(values, scores)
    ax.step(scores, [s.value for s in shares], where="post", color=look.color, ls=look.line)
    ax.plot(values, [s.value for s in profile(values, values)], ls="", color=look.color,
            marker=look.marker)  # fmt: skip
    ax.fill_between(scores, [s.low for s in shares], [s.high for s in shares], step="post",
                    color=look.color, alpha=0.13, lw=0)  # fmt: skip
