"""Curves over a parameter: ε by iteration, effort by size of a task, power by number of trials."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from trl_explore.names import strategy_label
from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures import axes
from trl_explore.report.figures.panels import fill_panels
from trl_explore.report.layouts import Lines, lines_by_size, size_of, size_sentence
from trl_explore.report.style import INK, MUTED, Style, styles
from trl_explore.statistics.power import (
    POWER,
    detectable_difference,
    fewest_pairs,
    trials_for_difference,
    trials_text,
)

MARKS = 6
CHOSEN = 0.99
"""The decay rate of the thesis."""


def plot_epsilon(
    ax: Axes,
    rates: Sequence[float],
    styles: Sequence[Style],
    *,
    iterations: int,
    emphasised: float | None = None,
) -> None:
    """Draw ε(i) = rate^i, the probability of a random action; ``emphasised`` gets a thick line."""
    i = np.arange(iterations + 1)
    every = max(1, iterations // MARKS)
    for k, (rate, style) in enumerate(zip(rates, styles, strict=True)):
        first = every * (k + 1) // (len(rates) + 1)
        ax.plot(
            i, rate**i, color=style.color, ls=style.line, marker=style.marker,
            lw=2.6 if rate == emphasised else 1.3, markevery=(first, every),
        )  # fmt: skip
    ax.set_xlim(0, iterations)
    ax.set_ylim(-0.02, 1.02)
    ax.set_xlabel("iteration")
    ax.set_ylabel("ε: probability of a random action")
    ax.grid()
    axes.plain_numbers(ax.xaxis)
    handles = [axes.handle(s, f"{r:g}") for r, s in zip(rates, styles, strict=True)]
    axes.legend_above(ax, handles, columns=min(4, len(rates)), title="decay rate")


def _rates(e: GroupEvidence) -> dict[float, str]:
    """Decay rate -> name of the configuration, for decaying ε-greedy."""
    return {
        float(c.parameters["decay"]): c.name
        for c in e.group.configurations
        if c.strategy == "decaying_epsilon_greedy"
        and isinstance(c.parameters.get("decay"), int | float)
    }


@axes.kind(
    "epsilon",
    "ε under the decay rates",
    lambda e: e.group.experiment == "decay_grid" and len(_rates(e)) > 0,
    thesis={"decay_grid": "2.5"},
)
def epsilon(e: GroupEvidence) -> axes.Shown:
    """ε by iteration for each rate."""
    rates, figure = _rates(e), axes.new_figure(3.2)
    looks = [e.group.styles[name] for name in rates.values()]
    end = min(e.group.cap, 600)
    plot_epsilon(figure.subplots(), list(rates), looks, iterations=end, emphasised=CHOSEN)
    return figure, (
        f"Probability of a random action in each iteration. The thesis chose {CHOSEN}"
        f" (thick line), which halves ε every {np.log(0.5) / np.log(CHOSEN):.0f} iterations."
    )


MOST_TICKS = 8
"""The most sizes of which each has a tick."""
EPISODES_OF_UNIFORM = "trl_explore/DeepSea-v0"
"""The environment in which uniform actions earn the reward in one of 2^size episodes."""
OVER = 1.25
"""The factor between the rows of marks above the cap."""


def _draw_panel(ax: Axes, title: str, panel: Lines, e: GroupEvidence) -> None:
    """The medians of every strategy; those over the cap in rows above it."""
    cap, looks = e.group.cap, dict(zip(panel, styles(list(panel)), strict=True))
    ticks = sorted(map(size_of, e.group.configurations))  # of all panels, which share their axes
    for k, (strategy, line) in enumerate(panel.items()):
        style, sizes = looks[strategy], np.array(list(line))
        estimates = [e.summary(c.name).median for c in line.values()]
        medians = np.array([estimate.value for estimate in estimates])
        low = np.array([estimate.low for estimate in estimates])
        high = np.minimum([estimate.high for estimate in estimates], cap)
        known = np.isfinite(medians)
        look = {"color": style.color, "marker": style.marker, "ms": 4.5}
        ax.plot(sizes[known], medians[known], ls=style.line, lw=1.4, zorder=3, **look)
        shift = 0.1 * (k - (len(panel) - 1) / 2)
        ax.vlines(
            sizes[known] + shift, low[known], high[known], color=style.color, alpha=0.35, lw=1.6
        )
        rows = np.full((~known).sum(), cap * OVER ** (k + 1))
        ax.plot(sizes[~known], rows, ls="", markerfacecolor="none", **look)
    ax.axhline(cap, color=INK, lw=0.8, zorder=1)
    if e.group.env_id == EPISODES_OF_UNIFORM:
        ends = np.linspace(ticks[0], min(ticks[-1], math.log2(cap / math.log(2))), 50)
        ax.plot(ends, math.log(2) * 2.0**ends, color=INK, lw=1.2, ls=axes.DASHED, zorder=2)
    ax.set_title(title, loc="left", color=INK)
    ax.set_yscale("log")
    # The panels share their axis, and the rows above the cap differ in number.
    ax.set_ylim(top=max(ax.get_ylim()[1], cap * OVER ** (len(panel) + 1)))
    ax.set_xlim(ticks[0] - 0.7, ticks[-1] + 0.7)
    ax.grid()
    axes.plain_numbers(ax.yaxis)


@axes.kind("first-reward", "How the effort grows with the size", lambda e: e.group.sized, hero=True)
def first_reward(e: GroupEvidence) -> axes.Shown:
    """The median effort of every strategy by the size of the task."""
    panels = lines_by_size(e.group.configurations)
    names = list(dict.fromkeys(c.strategy for c in e.group.configurations))
    quantity, uniform = "iterations until passed", ""
    if e.group.window == 1:
        quantity = f"episodes to the first score above {e.group.threshold:g}"
    if e.group.env_id == EPISODES_OF_UNIFORM:
        uniform = (
            " Dashed: the median of uniformly random actions, 2^size · ln 2; one of the 2^size"
            " sequences of actions has the reward."
        )
    figure = axes.new_figure(1.2 + 3.1 * math.ceil(len(panels) / 2))
    fill_panels(
        figure, list(panels.items()), lambda ax, item: _draw_panel(ax, *item, e), "size", quantity
    )
    sizes = sorted(set(map(size_of, e.group.configurations)))
    if len(sizes) <= MOST_TICKS:
        figure.axes[0].set_xticks(sizes)  # shared by all panels
    entries = zip(names, styles(names), strict=True)
    handles = [axes.handle(style, strategy_label(name)) for name, style in entries]
    axes.legend_above(figure.axes[0], handles, columns=3)
    return figure, (
        f"Kaplan–Meier median of the {quantity}, with its interval. Hollow marks above the"
        f" line: fewer than half of the trials got there within the cap of {e.group.cap:,}."
        f"{uniform} {size_sentence(e.group.configurations)}"
    )


COLOR = "#0072b2"


@dataclass(frozen=True)
class Pair:
    """A comparison: standard deviation of the paired difference, observed |difference|, verdict."""

    label: str
    sd: float
    difference: float
    told_apart: bool


def plot_power(ax: Axes, pairs: Sequence[Pair], *, trials: int, level: float) -> None:
    """Draw the smallest difference that is detected with 80 % power, by number of trials.

    The line is for the median standard deviation of the pairs; the band reaches from the smallest
    to the largest. Both begin at the fewest trials with which a difference can be significant. Each
    point is a pair: its observed difference, and the number of trials that would detect it with
    that power. For points left of the vertical line there were enough trials. ``level`` is that of
    one test.
    """
    known = [p for p in pairs if np.isfinite(p.sd) and p.sd > 0]
    needed = [trials_for_difference(p.sd, p.difference, level=level) for p in known]
    shown = [(n, p) for n, p in zip(needed, known, strict=True) if n is not None and np.isfinite(n)]
    right = max([10 * trials, 1000, *(2 * n for n, _ in shown)])
    n = np.geomspace(fewest_pairs(level), right, 60)
    low, middle, high = np.quantile([p.sd for p in known], [0.0, 0.5, 1.0])
    curves = [detectable_difference(sd, n, level=level) for sd in (low, middle, high)]
    ax.fill_between(n, curves[0], curves[2], color=COLOR, alpha=0.15, lw=0)
    ax.plot(n, curves[1], color=COLOR)
    for count, pair in shown:
        ax.plot(
            [count], [abs(pair.difference)], ls="", marker="o" if pair.told_apart else "D",
            ms=5, color=INK if pair.told_apart else "#d55e00", zorder=4,
        )  # fmt: skip
    ax.axvline(trials, color=INK, lw=1.0, ls=axes.DASHED)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(1.6, right)
    ax.set_xlabel("trials per configuration (logarithmic)")
    ax.set_ylabel("difference in iterations (logarithmic)")
    ax.grid()
    axes.plain_numbers(ax.xaxis)
    axes.plain_numbers(ax.yaxis)
    handles = [
        Line2D([], [], color=COLOR, label=f"detected with {100 * POWER:g} % power"),
        Line2D([], [], color=INK, lw=1.0, ls=axes.DASHED, label=f"this study: {trials:,} trials"),
        Line2D([], [], ls="", marker="o", color=INK, label="pair with a significant difference"),
        Line2D([], [], ls="", marker="D", color="#d55e00", label="pair without"),
    ]
    present = {p.told_apart for _, p in shown}
    axes.legend_above(ax, handles[:2] + [h for h, k in zip(handles[2:], (True, False), strict=True)
                                    if k in present], columns=2)  # fmt: skip
    ax.tick_params(which="minor", color=MUTED)


def _pairs(e: GroupEvidence) -> list[Pair]:
    """The comparisons whose standard deviation is known and not zero."""
    labels = e.group.labels
    return [
        Pair(f"{labels[c.a]} vs. {labels[c.b]}", c.sd, c.difference.value, c.winner is not None)
        for c in e.comparisons
        if np.isfinite(c.sd) and c.sd > 0
    ]


@axes.kind(
    "power",
    "What this number of trials can show",
    lambda e: axes.whole_study(e) and axes.few(e) and len(_pairs(e)) > 0,
)
def power(e: GroupEvidence) -> axes.Shown:
    """The detectable difference at the level of one test after correction."""
    pairs, level, tests = _pairs(e), e.strict_level, len(e.comparisons)
    n = min(min(c.n_a, c.n_b) for c in e.comparisons)
    figure = axes.new_figure(3.4)
    plot_power(figure.subplots(), pairs, trials=n, level=level)
    low, high = (
        float(detectable_difference(f([p.sd for p in pairs]), n, level=level)) for f in (min, max)
    )
    found = (
        f"With {n:,} trials per configuration, a difference of {low:,.0f} iterations (the least"
        f" variable pair) to {high:,.0f} (the most variable pair) is detected with"
        f" {100 * POWER:g} % power after correction for {tests} pairs."
    )
    if n < (fewest := fewest_pairs(level)):
        found = (
            f"{n:,} trials per configuration cannot detect any difference, however large, after"
            f" correction for {tests} pairs; at least {fewest} are needed."
        )
    needed = [
        f"{p.label} {trials_text(trials)}"
        for p in pairs
        if not p.told_apart
        and (trials := trials_for_difference(p.sd, p.difference, level=level)) is not None
    ]
    unsettled = (
        f" Pairs without a significant difference, and the trials needed: {'; '.join(needed[:3])}."
        if needed
        else ""
    )
    return figure, (
        f"{found} Each point is a pair: its observed difference, and the number of trials that"
        " would detect it. Pairs right of the dashed line need more trials than this study has."
        f" Band: from the least to the most variable pair.{unsettled}"
    )
