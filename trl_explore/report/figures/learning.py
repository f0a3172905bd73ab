"""Learning curves: mean score by iteration, in training and of the greedy policy."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trl_explore.report.curves import Curve
from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures.axes import line_count, new_figure, plain_numbers, wrapped
from trl_explore.report.figures.kind import Kind, crossed, few, whole_study
from trl_explore.report.figures.panels import (
    MARKS,
    PANELS_PER_ROW,
    Panel,
    draw_panels,
    fill_panels,
    limits_of,
    panels_of,
    plot_curves,
)
from trl_explore.report.style import INK, LineStyle, Style

GREEDY: LineStyle = (0, (5.0, 2.0))
"""Line style of evaluations."""


def plot_learning(
    ax: Axes,
    curve: Curve,
    style: Style,
    *,
    title: str = "",
    others: Sequence[tuple[Curve, Style]] = (),
    threshold: float | None = None,
) -> None:
    """Draw one learning curve with its band, and the other means as thin lines."""
    for other, look in others:
        ax.plot(other.iterations, other.mean, color=look.color, lw=0.8, alpha=0.45, zorder=1)
    if curve.low is not None and curve.high is not None:
        ax.fill_between(curve.iterations, curve.low, curve.high, color=style.color, alpha=0.2, lw=0)
    every = max(1, len(curve.iterations) // MARKS)
    ax.plot(
        curve.iterations, curve.mean, color=style.color, ls=style.line, marker=style.marker,
        markevery=(every // 2, every), zorder=3,
    )  # fmt: skip
    if threshold is not None:
        ax.axhline(threshold, color=INK, lw=1.0, ls=(0, (4, 3)), zorder=2)
    ax.set_title(wrapped(title, 28), loc="left", color=INK)
    ax.grid()
    curves = [curve, *(other for other, _ in others)]
    ax.set_ylim(bottom=min(0.0, *(float(np.nanmin(c.mean)) for c in curves)))
    plain_numbers(ax.xaxis)
    plain_numbers(ax.yaxis)


def _quantity(e: GroupEvidence) -> str:
    return f"mean score, last {e.group.window} episodes"


def _draw_learning(e: GroupEvidence) -> Figure:
    """One panel per configuration, all on the same axes."""
    group, curves = e.group, e.traces.learning
    names = list(curves)
    lines = math.ceil(len(names) / min(PANELS_PER_ROW, len(names)))
    height = 1.5 + 0.15 * max(line_count(group.labels[name], 28) for name in names)

    def draw(ax: Axes, name: str) -> None:
        others = [(curves[n], group.styles[n]) for n in names if n != name]
        plot_learning(ax, curves[name], group.styles[name], title=group.labels[name],
                      others=others, threshold=group.threshold)  # fmt: skip

    figure = new_figure(1.0 + height * lines)
    fill_panels(figure, names, draw, "iteration", _quantity(e))
    return figure


def _learning_caption(e: GroupEvidence) -> str:
    curves = e.traces.learning
    bands = any(curve.low is not None for curve in curves.values())
    what = "Line: mean over trials" + ("; band: middle half of the trials" if bands else "")
    absent = "" if bands else " There are no bands because episodes were not recorded."
    missing = len(e.group.configurations) - len(curves)
    none = f" Configurations without a recorded curve: {missing}." if missing else ""
    return (
        f"{what}; thin lines: the other configurations. Stopped trials keep their last score. The"
        f" dashed line is the score to pass, {e.group.threshold:g}.{absent}{none}"
    )


def _draw_panels(e: GroupEvidence) -> Figure:
    """One panel per row of a crossed group."""
    group = e.group
    curves = {name: Curve(c.iterations, c.mean) for name, c in e.traces.learning.items()}
    limits = limits_of(list(curves.values()), line=group.threshold)

    def draw(ax: Axes, panel: Panel) -> None:
        mine = [(curves[name], group.styles[name]) for name in panel.names if name in curves]
        if mine:
            plot_curves(ax, mine, title=panel.title, line=group.threshold, limits=limits)

    return draw_panels(group, draw, panels_of(group), "iteration", _quantity(e))


def _panels_caption(e: GroupEvidence) -> str:
    return (
        "Mean over trials; stopped trials keep their last score. The dashed line is the score"
        f" to pass, {e.group.threshold:g}."
    )


def _draw_evaluation(e: GroupEvidence) -> Figure:
    """Draw the scores in training and of the greedy policy, one panel per configuration."""
    group, curves = e.group, e.traces.evaluations
    panels = [Panel(group.labels[name], (name,)) for name in curves]
    limits = limits_of([c for pair in curves.values() for c in pair], line=group.threshold)

    def draw(ax: Axes, panel: Panel) -> None:
        color = group.styles[panel.names[0]].color
        looks = Style(color, "o", "-"), Style(color, "D", GREEDY)
        pair = list(zip(curves[panel.names[0]], looks, strict=True))
        plot_curves(ax, pair, title=panel.title, line=group.threshold, limits=limits)

    neutral = [("training", Style("#5f6670", "o", "-")),
               ("greedy policy, evaluated", Style("#5f6670", "D", GREEDY))]  # fmt: skip
    return draw_panels(group, draw, panels, "iteration", "mean score", legend=neutral)


def _evaluation_caption(e: GroupEvidence) -> str:
    gains = []
    for name, (training, greedy) in list(e.traces.evaluations.items())[:6]:
        ends = greedy.mean[-1] - training.mean[-1]
        sign = "+" if ends >= 0 else "−"
        gains.append(f"{e.group.labels[name]} {sign}{abs(ends):.3g}")
    return (
        "Solid: score in training, which includes the cost of exploration. Dashed: score of the"
        " same agents in separate evaluation episodes, in which they take the greedy action and do"
        " not learn. Means over trials; stopped trials keep their last score. Greedy minus training"
        f" at the end: {'; '.join(gains)}."
    )


LEARNING = Kind(
    "learning",
    "Learning curves",
    lambda e: whole_study(e) and few(e) and len(e.traces.learning) > 0,
    _draw_learning,
    _learning_caption,
)
PANELS = Kind(
    "learning-panels",
    "Learning curves",
    lambda e: crossed(e) and len(e.traces.learning) > 0,
    _draw_panels,
    _panels_caption,
)
EVALUATION = Kind(
    "evaluation",
    "The agent without exploration",
    lambda e: few(e) and len(e.traces.evaluations) > 0,
    _draw_evaluation,
    _evaluation_caption,
)
