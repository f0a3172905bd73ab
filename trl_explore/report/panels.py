"""Figures of several panels: configurations in a layout, and what was recorded along the runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy import stats

from trl_explore.report.drawing import PANELS_PER_ROW, new_figure
from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures import curves, effects, learning, plane, survival
from trl_explore.report.figures.axes import few_ticks, handle, legend_above, spans_much
from trl_explore.report.groups import Group
from trl_explore.report.style import INK, Style
from trl_explore.statistics.estimates import Estimate
from trl_explore.statistics.outcomes import convergence_times
from trl_explore.statistics.survival import kaplan_meier


@dataclass(frozen=True)
class Quantity:
    """A diagnostic: what its axis says, a dashed line, limits, and how these are found."""

    axis: str
    line: float | None = None
    limits: tuple[float, float] | None = None
    may_be_log: bool = False
    from_zero: bool = True


QUANTITIES = {
    "kl": Quantity("KL(μ‖π), nats"),
    "effective_sample_size": Quantity("effective share of the frames", limits=(0.0, 1.04)),
    "ratio_mean": Quantity("mean of π/μ over an episode", line=1.0, from_zero=False),
    "exploratory": Quantity("share of actions that are not greedy", limits=(0.0, 1.0)),
    "greedy_share": Quantity("share of the more frequent greedy action", limits=(0.0, 1.04)),
    "coverage": Quantity("cells visited so far", may_be_log=True),
    "gradient_norm": Quantity("length of the gradient", may_be_log=True),
}


@dataclass(frozen=True)
class Panel:
    """The title of a panel, and the names of its configurations."""

    title: str
    names: tuple[str, ...]


def panels_of(group: Group) -> list[Panel]:
    """One panel per row of a crossed group; else one of all configurations, without a title."""
    if group.crossed is None:
        return [Panel("", tuple(c.name for c in group.configurations))]
    cells = sorted(group.crossed.cells.items())
    return [
        Panel(row, tuple(name for (r, _), name in cells if r == k))
        for k, row in enumerate(group.crossed.rows)
    ]


def draw_survival_panels(group: Group) -> Figure:
    """Kaplan-Meier curves of a crossed group, one panel per row."""
    end = float(max(int(c.durations.max()) for c in group.configurations))

    def draw(ax: Axes, panel: Panel) -> None:
        rows = []
        for name in panel.names:
            c = next(c for c in group.configurations if c.name == name)
            durations, converged = convergence_times(c)
            curve = kaplan_meier(durations, converged)
            rows.append(survival.Row(group.labels[name], curve, durations, group.styles[name]))
        survival.plot_survival_panel(ax, rows, title=panel.title, horizon=end)

    return _panels(group, draw, panels_of(group), "iterations", "trials not yet converged")


def draw_learning_panels(evidence: GroupEvidence) -> Figure:
    """Learning curves of a crossed group, one panel per row."""
    group = evidence.group
    rows = dict(zip(group.labels.values(), group.labels, strict=True))
    by_name = {rows[row.label]: _bare(row) for row in evidence.learning}
    limits = curves.limits_of(list(by_name.values()), line=group.threshold)

    def draw(ax: Axes, panel: Panel) -> None:
        mine = [by_name[name] for name in panel.names if name in by_name]
        if mine:
            curves.plot_curves(ax, mine, title=panel.title, line=group.threshold, limits=limits)

    quantity = f"mean score, last {group.window} episodes"
    return _panels(group, draw, panels_of(group), "iteration", quantity)


def draw_diagnostic(evidence: GroupEvidence, name: str) -> Figure:
    """One quantity of ``QUANTITIES`` by iteration."""
    group, quantity = evidence.group, QUANTITIES[name]
    rows = evidence.traces.diagnostics[name]
    log = quantity.may_be_log and spans_much([row.mean for row in rows.values()])
    limits = quantity.limits or curves.limits_of(
        [*rows.values()], line=quantity.line, log=log, from_zero=quantity.from_zero
    )

    def draw(ax: Axes, panel: Panel) -> None:
        mine = [rows[n] for n in panel.names if n in rows]
        if mine:
            curves.plot_curves(ax, mine, title=panel.title, line=quantity.line,
                               limits=limits, log=log)  # fmt: skip

    axis = quantity.axis + (" (logarithmic)" if log else "")
    return _panels(group, draw, panels_of(group), "iteration", axis)


def draw_entropy(evidence: GroupEvidence) -> Figure:
    """The entropies of π (left) and μ (right), in pairs of panels."""
    group = evidence.group
    tables = evidence.traces.diagnostics
    panels = [
        Panel(f"{panel.title}: {policy}" if panel.title else policy, panel.names)
        for panel in panels_of(group)
        for policy in ("π", "μ")
    ]
    columns = {"π": "entropy_policy", "μ": "entropy_behaviour"}
    limits = curves.limits_of([r for c in columns.values() for r in tables.get(c, {}).values()])

    def draw(ax: Axes, panel: Panel) -> None:
        rows = tables.get(columns[panel.title[-1]], {})
        mine = [rows[n] for n in panel.names if n in rows]
        if mine:
            curves.plot_curves(ax, mine, title=panel.title, limits=limits)

    return _panels(group, draw, panels, "iteration", "entropy, nats")


def draw_evaluation(evidence: GroupEvidence) -> Figure:
    """Score in training and of the greedy policy, one panel per configuration."""
    group, rows = evidence.group, evidence.traces.evaluations
    panels = [Panel(group.labels[name], (name,)) for name in rows]
    limits = curves.limits_of([r for pair in rows.values() for r in pair], line=group.threshold)

    def draw(ax: Axes, panel: Panel) -> None:
        training, greedy = rows[panel.names[0]]
        pair = [_styled(training, Style(training.style.color, "o", "-")),
                _styled(greedy, Style(training.style.color, "D", (0, (5.0, 2.0))))]  # fmt: skip
        curves.plot_curves(ax, pair, title=panel.title, line=group.threshold, limits=limits)

    neutral = [("training", Style("#5f6670", "o", "-")),
               ("greedy policy, evaluated", Style("#5f6670", "D", (0, (5.0, 2.0))))]  # fmt: skip
    return _panels(group, draw, panels, "iteration", "mean score", legend=neutral)


def draw_effects(evidence: GroupEvidence) -> Figure:
    """Pass rate and mean iterations of a crossed group, with the options on the axis."""
    group = evidence.group
    layout = group.crossed
    assert layout is not None
    z = float(stats.norm.ppf((1.0 + evidence.level) / 2.0))
    rates, means = [], []
    for (row, option), name in layout.cells.items():
        summary, style = evidence.summary(name), group.styles[name]
        rate, mean, half = summary.pass_rate, summary.restricted_mean, summary.restricted_mean_se
        percent = Estimate(100 * rate.value, 100 * rate.low, 100 * rate.high, rate.level)
        rates.append(effects.Dot(row, option, percent, style))
        interval = Estimate(mean, mean - z * half, mean + z * half, evidence.level)
        means.append(effects.Dot(row, option, interval, style))
    rows, n = layout.rows, len(layout.options)
    figure = new_figure(1.25 + 0.155 * effects.height(len(rows), 0, n))
    left, right = figure.subplots(1, 2, sharey=True)
    effects.plot_effects(left, rates, rows, n, quantity="trials that pass, %")
    effects.plot_effects(right, means, rows, n, quantity="mean iterations")
    right.tick_params(axis="y", labelleft=False)
    left.set_xlim(-4, 104)
    left.set_xticks([0, 25, 50, 75, 100])
    right.xaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 2.5, 5, 10]))
    right.set_xlim(0, 1.04 * group.cap)
    _legend(left, _options(group))
    return figure


def draw_map(evidence: GroupEvidence, what: str) -> Figure:
    """Map of the pass rate (``pass``) or of the restricted mean (``iterations``)."""
    group = evidence.group
    layout = group.plane
    assert layout is not None
    values = np.full((len(layout.xs), len(layout.ys)), np.nan)
    for (i, j), name in layout.cells.items():
        summary = evidence.summary(name)
        values[i, j] = 100 * summary.pass_rate.value if what == "pass" else summary.restricted_mean
    scale = (0.0, 100.0) if what == "pass" else (float(group.cap), float(np.nanmin(values)))
    marked = next((place for place, n in layout.cells.items() if n == layout.reference), None)
    figure = new_figure(0.95 + 0.36 * len(layout.ys))
    ax = figure.subplots()
    plane.plot_plane(
        ax, values, layout.xs, layout.ys, x=layout.x, y=layout.y, scale=scale,
        text=lambda value: f"{value:,.0f}", marked=marked,
    )  # fmt: skip
    title = "trials that pass, %" if what == "pass" else "mean iterations"
    ax.set_title(title, loc="left", color=INK)
    return figure


def _bare(row: learning.Row) -> learning.Row:
    return learning.Row(row.label, row.iterations, row.mean, None, None, row.style)


def _styled(row: learning.Row, style: Style) -> learning.Row:
    return learning.Row(row.label, row.iterations, row.mean, row.low, row.high, style)


def _options(group: Group) -> list[tuple[str, Style]]:
    """What the legend of a group names: its options, or its configurations."""
    if group.crossed is None:
        return [(group.labels[c.name], group.styles[c.name]) for c in group.configurations]
    looks = {option: group.styles[name] for (_, option), name in group.crossed.cells.items()}
    return [(group.crossed.options[k], looks[k]) for k in sorted(looks)]


def _legend(ax: Axes, entries: Sequence[tuple[str, Style]]) -> None:
    columns = 2 if max(len(label) for label, _ in entries) > 12 or len(entries) == 4 else 3
    legend_above(ax, [handle(style, label) for label, style in entries], columns=columns)


def _panels(
    group: Group,
    draw: Callable[[Axes, Panel], None],
    panels: Sequence[Panel],
    x: str,
    y: str,
    *,
    legend: Sequence[tuple[str, Style]] | None = None,
) -> Figure:
    """Panels on common axes, two in a line, under one legend."""
    columns = min(PANELS_PER_ROW, len(panels))
    lines = math.ceil(len(panels) / columns)
    entries = list(legend or _options(group))
    figure = new_figure(1.05 + 0.1 * len(entries) + (1.55 if columns > 1 else 2.4) * lines)
    axes = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for k, ax in enumerate(axes.ravel()):
        if k >= len(panels):
            ax.set_axis_off()
            continue
        draw(ax, panels[k])
        ax.set_xlabel("")
        if ax.get_xscale() == "linear":
            few_ticks(ax.xaxis)
        ax.tick_params(labelbottom=k + columns >= len(panels))
    figure.supxlabel(x, fontsize=9)
    figure.supylabel(y, fontsize=9)
    _legend(axes[0, 0], entries)
    return figure
