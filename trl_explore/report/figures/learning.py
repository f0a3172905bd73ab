"""Curves by iteration: scores, and what was recorded during training."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trl_explore.report.curves import Curve
from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures import axes
from trl_explore.report.figures.panels import (
    MARKS,
    PANELS_PER_ROW,
    draw_panels,
    fill_panels,
    frame,
    limits_of,
    panels_of,
    plot_curves,
)
from trl_explore.report.style import MUTED, LineStyle, Style
from trl_explore.training.diagnostic_quantities import DIAGNOSTICS, Diagnostic

GREEDY: LineStyle = (0, (5.0, 2.0))
"""Line style of evaluations."""
CurvesPanel = tuple[str, Sequence[tuple[Curve, Style]]]
"""Title of a panel, and its curves."""


def plot_learning(
    ax: Axes,
    curve: Curve,
    style: Style,
    *,
    title: str,
    others: Sequence[tuple[Curve, Style]],
    threshold: float,
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
    frame(ax, title, threshold)
    curves = [curve, *(other for other, _ in others)]
    ax.set_ylim(bottom=min(0.0, *(float(np.nanmin(c.mean)) for c in curves)))


def _quantity(e: GroupEvidence) -> str:
    return f"mean score, last {e.group.window} episodes"


@axes.kind(
    "learning",
    "Learning curves",
    lambda e: axes.whole_study(e) and axes.few(e) and len(e.traces.learning) > 0,
)
def learning(e: GroupEvidence) -> axes.Shown:
    """One panel per configuration, all on the same axes."""
    group, curves = e.group, e.traces.learning
    names = list(curves)
    lines = math.ceil(len(names) / min(PANELS_PER_ROW, len(names)))
    height = 1.5 + 0.15 * max(axes.line_count(group.labels[name], 28) for name in names)

    def draw(ax: Axes, name: str) -> None:
        others = [(curves[n], group.styles[n]) for n in names if n != name]
        plot_learning(ax, curves[name], group.styles[name], title=group.labels[name],
                      others=others, threshold=group.threshold)  # fmt: skip

    figure = axes.new_figure(1.0 + height * lines)
    fill_panels(figure, names, draw, "iteration", _quantity(e))
    bands = any(curve.low is not None for curve in curves.values())
    what = "Line: mean over trials" + ("; band: middle half of the trials" if bands else "")
    absent = "" if bands else " There are no bands because episodes were not recorded."
    missing = len(group.configurations) - len(curves)
    none = f" Configurations without a recorded curve: {missing}." if missing else ""
    return figure, (
        f"{what}; thin lines: the other configurations. Stopped trials keep their last score. The"
        f" dashed line is the score to pass, {group.threshold:g}.{absent}{none}"
    )


def _draw(
    e: GroupEvidence,
    panels: Sequence[CurvesPanel],
    quantity: str,
    *,
    line: float | None = None,
    log: bool = False,
    from_zero: bool = True,
    limits: tuple[float, float] | None = None,
    legend: Sequence[tuple[str, Style]] | None = None,
) -> Figure:
    """Panels of curves; without ``limits``, they fit all curves."""
    every = [curve for _, rows in panels for curve, _ in rows]
    limits = limits or limits_of(every, line=line, log=log, from_zero=from_zero)

    def draw(ax: Axes, panel: CurvesPanel) -> None:
        if panel[1]:
            plot_curves(ax, panel[1], title=panel[0], line=line, limits=limits, log=log)

    return draw_panels(e.group, draw, panels, "iteration", quantity, legend=legend)


def _panels(e: GroupEvidence, curves: Mapping[str, Curve], title: str = "") -> list[CurvesPanel]:
    """The curves of each panel of the group; ``title`` follows that of the panel."""
    return [
        (
            ": ".join(w for w in (panel.title, title) if w),
            [(curves[name], e.group.styles[name]) for name in panel.names if name in curves],
        )
        for panel in panels_of(e.group)
    ]


@axes.kind(
    "learning-panels", "Learning curves", lambda e: axes.crossed(e) and len(e.traces.learning) > 0
)
def panels(e: GroupEvidence) -> axes.Shown:
    """One panel per row of a crossed group."""
    curves = {name: Curve(c.iterations, c.mean) for name, c in e.traces.learning.items()}
    threshold = e.group.threshold
    return _draw(e, _panels(e, curves), _quantity(e), line=threshold), (
        "Mean over trials; stopped trials keep their last score. The dashed line is the score"
        f" to pass, {threshold:g}."
    )


@axes.kind(
    "evaluation",
    "The agent without exploration",
    lambda e: axes.few(e) and len(e.traces.evaluations) > 0,
)
def evaluation(e: GroupEvidence) -> axes.Shown:
    """The scores in training and of the greedy policy, one panel per configuration."""
    group, gains, found = e.group, [], []
    for name, (training, greedy) in e.traces.evaluations.items():
        color, label = group.styles[name].color, group.labels[name]
        found.append(
            (label, [(training, Style(color, "o", "-")), (greedy, Style(color, "D", GREEDY))])
        )
        ends = greedy.mean[-1] - training.mean[-1]
        gains.append(f"{label} {'+' if ends >= 0 else '−'}{abs(ends):.3g}")
    neutral = [("training", Style(MUTED, "o", "-")),
               ("greedy policy, evaluated", Style(MUTED, "D", GREEDY))]  # fmt: skip
    return _draw(e, found, "mean score", line=group.threshold, legend=neutral), (
        "Solid: score in training, which includes the cost of exploration. Dashed: score of the"
        " same agents in separate evaluation episodes, in which they take the greedy action and do"
        " not learn. Means over trials; stopped trials keep their last score. Greedy minus training"
        f" at the end: {'; '.join(gains[:6])}."
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
    readable = axes.crossed(e) or len(e.group.configurations) <= FEWER
    return readable and name in e.traces.diagnostics


def _diagnostic(e: GroupEvidence, name: str, quantity: Diagnostic) -> axes.Shown:
    curves = e.traces.diagnostics[name]
    log = quantity.may_be_log and axes.spans_much([curve.mean for curve in curves.values()])
    limits = (0.0, 1.04) if quantity.bounds == (0.0, 1.0) else None
    axis = quantity.axis + (" (logarithmic)" if log else "")
    figure = _draw(e, _panels(e, curves), axis, line=quantity.line, log=log,
                   from_zero=quantity.from_zero, limits=limits)  # fmt: skip
    layout, labels, option = e.group.crossed, e.group.labels, ""
    if layout is not None:  # only the first option
        labels = {n: layout.rows[r] for (r, o), n in sorted(layout.cells.items()) if o == 0}
        option = f", {layout.options[0]}"
    means = [f"{labels[n]}: {_short(curves[n].level)}" for n in labels if n in curves][: axes.NAMED]
    return figure, (
        f"{quantity.caption}{HOW} Mean of each line over all iterations{option}:"
        f" {'; '.join(means)}."
    )


def _short(value: float) -> str:
    """A number with two digits, without an exponent.

    >>> _short(3.2e-10), _short(0.0966), _short(6620.0)
    ('< 0.001', '0.097', '6,620')
    """
    if 0 < abs(value) < 1e-3:
        return "< 0.001"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.2g}"


DIAGNOSTIC_KINDS = tuple(
    axes.FigureKind(
        name,
        quantity.title,
        partial(_recorded, name),
        partial(_diagnostic, name=name, quantity=quantity),
        recorded=True,
        why=name in WHY,
    )
    for name, quantity in DIAGNOSTICS.items()
    if not quantity.policy
)

ENTROPIES = {name: q.policy for name, q in DIAGNOSTICS.items() if q.policy}
FIRST = DIAGNOSTICS[next(iter(ENTROPIES))]


@axes.kind("entropy", FIRST.title, partial(_recorded, next(iter(ENTROPIES))), recorded=True)
def entropy(e: GroupEvidence) -> axes.Shown:
    """The entropies of π (left) and μ (right) in pairs of panels."""
    found = [_panels(e, e.traces.diagnostics.get(n, {}), str(p)) for n, p in ENTROPIES.items()]
    pairs = [panel for row in zip(*found, strict=True) for panel in row]
    return _draw(e, pairs, FIRST.axis), f"{FIRST.caption}{HOW}"
