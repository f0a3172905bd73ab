"""From evidence to drawn figures: sizes, axes, and which arrays go where."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures import forest, learning, power, survival, trials
from trl_explore.report.figures.axes import few_ticks, wrapped
from trl_explore.report.figures.epsilon_decay import plot_epsilon
from trl_explore.report.groups import Group
from trl_explore.report.style import WIDTH
from trl_explore.statistics.comparisons import Comparison
from trl_explore.statistics.estimates import Estimate
from trl_explore.statistics.outcomes import Outcomes, convergence_times
from trl_explore.statistics.pairing import select
from trl_explore.statistics.survival import kaplan_meier

PANELS_PER_ROW = 2
MOST_PAIRS = 15
"""Pairs in a forest plot; of more, those with the fastest configuration are shown."""


def _lines(label: str, width: int = 21) -> int:
    return wrapped(label, width).count("\n") + 1


Values = Callable[[Outcomes], tuple[Outcomes, np.ndarray]]


def new_figure(height: float) -> Figure:
    """An empty figure of the report's width and a height in inches."""
    figure = Figure(figsize=(WIDTH, height))
    figure.set_layout_engine("constrained", w_pad=0.06, h_pad=0.06)
    return figure


def draw_trials(
    group: Group,
    values: Values,
    quantity: str,
    line: tuple[float, str] | None,
    *,
    may_be_log: bool = True,
) -> Figure:
    """One row of points per configuration that ``values`` gives any for."""
    rows = []
    for c in group.configurations:
        shown, numbers = values(c)
        if len(shown):
            rows.append(
                trials.Row(group.short(c.name), numbers, shown.status, group.styles[c.name])
            )
    figure = new_figure(1.3 + sum(max(0.42, 0.17 * _lines(row.label)) for row in rows))
    trials.plot_trials(
        figure.subplots(),
        rows,
        quantity=quantity,
        of=group.parameter,
        line=line,
        may_be_log=may_be_log,
    )
    return figure


def scores(c: Outcomes) -> tuple[Outcomes, np.ndarray]:
    """Final scores of all trials."""
    return c, c.score.astype(np.float64)


def iterations(c: Outcomes) -> tuple[Outcomes, np.ndarray]:
    """Iterations of all trials; a diverged one stands at the cap."""
    return c, c.durations.astype(np.float64)


def frames(c: Outcomes) -> tuple[Outcomes, np.ndarray]:
    """Frames of all trials."""
    return c, c.frames.astype(np.float64)


def seconds(group: Group) -> Values:
    """Seconds of those trials that were timed by themselves."""

    def values(c: Outcomes) -> tuple[Outcomes, np.ndarray]:
        timing = group.timing(c.name)
        if timing is None:
            return select(c, np.zeros(0, dtype=np.intp)), np.zeros(0)
        first = {int(t): i for i, t in reversed(list(enumerate(c.trial)))}
        known = [(first[int(t)], s) for t, s in zip(timing.trial, timing.seconds, strict=True)
                 if int(t) in first]  # fmt: skip
        index = np.array([i for i, _ in known], dtype=np.intp)
        return select(c, index), np.array([s for _, s in known])

    return values


def draw_survival(group: Group, unit: str) -> Figure:
    """Kaplan-Meier curves in iterations or frames, with the numbers at risk below them."""
    rows = []
    end = max(int(c.frames.max()) for c in group.configurations)
    for c in group.configurations:
        durations, converged = convergence_times(c, unit)
        if unit == "frames":  # failed trials stay at risk to the end of the common axis
            durations = np.where(converged, durations, end)
        curve = kaplan_meier(durations, converged)
        rows.append(survival.Row(group.labels[c.name], curve, durations, group.styles[c.name]))
    below = 0.19 * (len(rows) * max(0.8 * _lines(row.label) + 0.2 for row in rows) + 1.2)
    figure = new_figure(3.1 + below)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.6, below])
    upper.tick_params(labelbottom=True)
    survival.plot_survival(upper, rows, time="iterations" if unit == "iterations" else "frames")
    low, high = upper.get_xlim()
    ticks = [t for t in upper.get_xticks() if low <= t <= high]
    survival.plot_numbers_at_risk(lower, rows, ticks)
    return figure


def draw_learning(evidence: GroupEvidence) -> Figure:
    """One panel per configuration, all on the same axes."""
    rows, columns = evidence.learning, min(PANELS_PER_ROW, len(evidence.learning))
    lines = math.ceil(len(rows) / columns)
    figure = new_figure(1.0 + (1.5 + 0.15 * max(_lines(r.label, 28) for r in rows)) * lines)
    panels = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for k, panel in enumerate(panels.ravel()):
        if k >= len(rows):
            panel.set_axis_off()
            continue
        others = [row for row in rows if row is not rows[k]]
        learning.plot_learning(panel, rows[k], others=others, threshold=evidence.group.threshold)
        few_ticks(panel.xaxis)
        panel.tick_params(labelbottom=k + columns >= len(rows))
    figure.supxlabel("iteration", fontsize=9)
    figure.supylabel(f"mean score, last {evidence.group.window} episodes", fontsize=9)
    return figure


def oriented(comparison: Comparison) -> tuple[str, str, Estimate]:
    """Faster and slower configuration of a pair, and what the first saves."""
    e = comparison.difference
    if e.value > 0:
        return comparison.b, comparison.a, e
    return comparison.a, comparison.b, Estimate(-e.value, -e.high, -e.low, e.level)


def shown_pairs(evidence: GroupEvidence) -> list[Comparison]:
    """The comparisons of the forest plot: all of them, or those with the fastest."""
    table = evidence.comparisons
    if len(table) <= MOST_PAIRS or evidence.group.crossed is not None:
        return table
    best = min(evidence.group.configurations, key=lambda c: float(c.durations.mean())).name
    return [c for c in table if best in (c.a, c.b)]


def draw_forest(evidence: GroupEvidence) -> Figure:
    """All pairs, the largest difference on top."""
    labels, looks = evidence.group.labels, evidence.group.styles
    layout = evidence.group.crossed
    rest = {n: layout.options[o] for (_, o), n in layout.cells.items()} if layout else labels
    rows = []
    for comparison in shown_pairs(evidence):
        first, second, difference = oriented(comparison)
        told_apart = comparison.winner is not None
        rows.append(forest.Row(labels[first], rest[second], difference, told_apart, looks[first]))
    rows.sort(key=lambda row: -row.difference.value)
    figure = new_figure(1.15 + sum(0.215 + 0.13 * forest.pair_label(r).count("\n") for r in rows))
    forest.plot_forest(figure.subplots(), rows, unit="iterations")
    return figure


def power_pairs(evidence: GroupEvidence) -> list[power.Pair]:
    """The comparisons whose spread is known and not nil."""
    labels = evidence.group.labels
    return [
        power.Pair(
            f"{labels[c.a]} vs. {labels[c.b]}", c.sd, c.difference.value, c.winner is not None
        )
        for c in evidence.comparisons
        if np.isfinite(c.sd) and c.sd > 0
    ]


def strict_level(evidence: GroupEvidence) -> float:
    """Level of one test such that all together keep theirs (Bonferroni)."""
    return 1.0 - (1.0 - evidence.level) / max(1, len(evidence.comparisons))


def draw_power(evidence: GroupEvidence) -> Figure:
    """The power figure at the level that the correction leaves to one pair."""
    figure = new_figure(3.4)
    n = min(min(c.n_a, c.n_b) for c in evidence.comparisons)
    power.plot_power(
        figure.subplots(), power_pairs(evidence), trials=n, level=strict_level(evidence)
    )
    return figure


def decay_rates(group: Group) -> dict[float, str]:
    """The decay rates of a group's decaying strategy -> name of the configuration."""
    return {
        float(c.parameters["decay"]): c.name
        for c in group.configurations
        if c.strategy == "decaying_epsilon_greedy"
        and isinstance(c.parameters.get("decay"), int | float)
    }


def draw_epsilon(group: Group) -> Figure:
    """ε by iteration for the decay rates of a group; the thesis's 0.99 is thick."""
    rates = decay_rates(group)
    figure = new_figure(3.2)
    ax: Axes = figure.subplots()
    looks = [group.styles[name] for name in rates.values()]
    plot_epsilon(ax, list(rates), looks, iterations=min(group.cap, 600), emphasised=0.99)
    return figure
