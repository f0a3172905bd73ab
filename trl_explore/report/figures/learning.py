"""Curves by iteration: scores, and what was recorded during training."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trl_explore.report.curves import Curve
from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures.axes import (
    NAMED,
    Kind,
    crossed,
    few,
    line_count,
    new_figure,
    plain_numbers,
    spans_much,
    whole_study,
    wrapped,
)
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
from trl_explore.training.quantities import DIAGNOSTICS, Diagnostic

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


FEWER = 12
"""Most configurations whose curves share a panel."""
WHY = ("kl", "effective_sample_size", "ratio_mean")
"""The quantities that measure the distance between μ and π."""
HOW = (
    " Line: median over trials; band: middle half; values averaged over 20 iterations."
    " Stopped trials keep their last value."
)


def _recorded(name: str, e: GroupEvidence) -> bool:
    readable = crossed(e) or len(e.group.configurations) <= FEWER
    return readable and name in e.traces.diagnostics


def _draw(e: GroupEvidence, name: str, quantity: Diagnostic) -> Figure:
    group, curves = e.group, e.traces.diagnostics[name]
    log = quantity.may_be_log and spans_much([curve.mean for curve in curves.values()])
    limits = limits_of(
        list(curves.values()), line=quantity.line, log=log, from_zero=quantity.from_zero
    )
    if quantity.bounds == (0.0, 1.0):
        limits = (0.0, 1.04)

    def draw(ax: Axes, panel: Panel) -> None:
        mine = [(curves[n], group.styles[n]) for n in panel.names if n in curves]
        if mine:
            plot_curves(ax, mine, title=panel.title, line=quantity.line,
                        limits=limits, log=log)  # fmt: skip

    axis = quantity.axis + (" (logarithmic)" if log else "")
    return draw_panels(group, draw, panels_of(group), "iteration", axis)


def _means(e: GroupEvidence, curves: dict[str, Curve]) -> str:
    """The mean of each curve; in a crossed group, only of the first option."""
    layout = e.group.crossed
    if layout is None:
        labels, option = e.group.labels, ""
    else:
        labels = {n: layout.rows[r] for (r, o), n in sorted(layout.cells.items()) if o == 0}
        option = f", {layout.options[0]}"
    texts = [f"{labels[n]}: {_short(curves[n].level)}" for n in labels if n in curves]
    return f" Mean of each line over all iterations{option}: {'; '.join(texts[:NAMED])}."


def _short(value: float) -> str:
    """A number with two digits, without an exponent.

    >>> _short(3.2e-10), _short(0.0966), _short(6620.0)
    ('< 0.001', '0.097', '6,620')
    """
    if 0 < abs(value) < 1e-3:
        return "< 0.001"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.2g}"


def _kind(name: str, quantity: Diagnostic) -> Kind:
    return Kind(
        name,
        quantity.title,
        lambda e: _recorded(name, e),
        lambda e: _draw(e, name, quantity),
        lambda e: f"{quantity.caption}{HOW}{_means(e, e.traces.diagnostics[name])}",
        recorded=True,
        why=name in WHY,
    )


DIAGNOSTIC_KINDS = tuple(_kind(name, q) for name, q in DIAGNOSTICS.items() if not q.policy)

ENTROPIES = tuple(name for name, quantity in DIAGNOSTICS.items() if quantity.policy)
FIRST = DIAGNOSTICS[ENTROPIES[0]]


def _draw_entropy(e: GroupEvidence) -> Figure:
    """Draw the entropies of π (left) and μ (right) in pairs of panels."""
    group = e.group
    panels = [
        replace(
            panel,
            title=f"{panel.title}: {DIAGNOSTICS[name].policy}".removeprefix(": "),
            quantity=name,
        )
        for panel in panels_of(group)
        for name in ENTROPIES
    ]
    found = {name: e.traces.diagnostics.get(name, {}) for name in ENTROPIES}
    limits = limits_of([curve for curves in found.values() for curve in curves.values()])

    def draw(ax: Axes, panel: Panel) -> None:
        curves = found[panel.quantity]
        mine = [(curves[n], group.styles[n]) for n in panel.names if n in curves]
        if mine:
            plot_curves(ax, mine, title=panel.title, limits=limits)

    return draw_panels(group, draw, panels, "iteration", FIRST.axis)


ENTROPY = Kind(
    "entropy",
    FIRST.title,
    lambda e: _recorded(ENTROPIES[0], e),
    _draw_entropy,
    lambda e: f"{FIRST.caption}{HOW}",
    recorded=True,
)
