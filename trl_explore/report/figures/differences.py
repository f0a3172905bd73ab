"""Figures of differences: pairs of configurations, options of a layout, acting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from trl_explore.report.decomposition import Acting, Decomposition
from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures import axes
from trl_explore.report.figures.panels import legend_of, options_of
from trl_explore.report.style import GRID, INK, MUTED, PAPER, Style, styles
from trl_explore.report.table_formats import negated
from trl_explore.statistics.comparisons import Comparison
from trl_explore.statistics.estimates import Estimate

MOST_PAIRS = 15
"""Most pairs in a forest plot; if there are more, only those with the fastest are shown."""


@dataclass(frozen=True)
class PairRow:
    """One pair; ``difference`` is how many iterations fewer the first needs."""

    first: str
    second: str
    difference: Estimate
    told_apart: bool
    style: Style


def pair_label(row: PairRow) -> str:
    """The label of a row, "A vs. B", in two lines if it is long."""
    first, second = axes.wrapped(row.first, 36, 1), axes.wrapped(row.second, 36, 1)
    return f"{first} vs. {second}" if len(first) + len(second) <= 26 else f"{first}\nvs. {second}"


def plot_forest(ax: Axes, rows: Sequence[PairRow]) -> None:
    """Draw each pair's difference with its interval; hollow if it is not significant."""
    words = {True: "significant", False: "not significant"}
    for y, row in enumerate(rows):
        color = row.style.color
        axes.bar(ax, row.difference, y, color=color, lw=1.7, zorder=2)
        ax.plot(
            [row.difference.value], [y], marker=row.style.marker, ms=6, mec=color,
            mfc=color if row.told_apart else PAPER, zorder=3, label=words[row.told_apart],
        )  # fmt: skip
    ax.axvline(0, color=INK, lw=1.0)
    labels, ends = [pair_label(row) for row in rows], (len(rows) - 0.4, -0.6)
    axes.rows_axis(ax, range(len(rows)), labels, ends, "iterations that the first saves")
    ax.tick_params(axis="y", labelsize=8.5)
    ax.grid(axis="y", color=GRID, lw=0.4)
    kinds = [k for k in words if any(row.told_apart == k for row in rows)]
    faces = {True: MUTED, False: PAPER}
    axes.legend_above(ax, axes.marks([(words[k], faces[k]) for k in kinds]), columns=2)


def oriented(comparison: Comparison) -> tuple[str, str, Estimate]:
    """Faster and slower configuration of a pair, and the iterations that the faster one saves."""
    e = comparison.difference
    if e.value > 0:
        return comparison.b, comparison.a, e
    return comparison.a, comparison.b, negated(e)


@axes.kind(
    "forest",
    "Every pair compared",
    lambda e: len(e.comparisons) > 0 and e.group.plane is None and not e.group.sized,
)
def forest(e: GroupEvidence) -> axes.Shown:
    """The pairs, the largest difference on top; of many, those with the fastest configuration."""
    labels, looks, layout, shown = e.group.labels, e.group.styles, e.group.crossed, e.comparisons
    if len(shown) > MOST_PAIRS and layout is None:
        best = min(e.group.configurations, key=lambda c: float(c.durations.mean())).name
        shown = [c for c in shown if best in (c.a, c.b)]
    rest = {n: layout.options[o] for (_, o), n in layout.cells.items()} if layout else labels
    rows = []
    for comparison in shown:
        first, second, difference = oriented(comparison)
        told_apart = comparison.winner is not None
        rows.append(PairRow(labels[first], rest[second], difference, told_apart, looks[first]))
    rows.sort(key=lambda row: -row.difference.value)
    figure = axes.new_figure(1.15 + sum(0.215 + 0.13 * pair_label(r).count("\n") for r in rows))
    plot_forest(figure.subplots(), rows)
    some = (
        f" Only the {len(shown)} pairs with the fastest configuration are shown; the table has all."
        if len(shown) < len(e.comparisons)
        else ""
    )
    return figure, (
        "Mean number of iterations (restricted to the cap) that the first of a pair saves compared"
        " with the second. Bar: interval at the level of the pair’s step in Holm’s correction for"
        f" all pairs, {100 * e.level:g} % together. Filled: significant, the interval excludes 0,"
        f" {sum(c.winner is not None for c in e.comparisons)} of {len(e.comparisons)} pairs.{some}"
    )


GAP = 0.9
"""Space between blocks, in rows."""


@dataclass(frozen=True)
class Dot:
    """One configuration: its block, its place in the block, its estimate and its style."""

    block: int
    place: int
    estimate: Estimate
    style: Style


def height(block: int, place: int, options: int) -> float:
    """Vertical position of a configuration, from top to bottom.

    >>> height(1, 0, 4)
    4.9
    """
    return block * (options + GAP) + place


def plot_effects(
    ax: Axes, dots: Sequence[Dot], blocks: Sequence[str], options: int, *, quantity: str
) -> None:
    """Draw each estimate with its interval, in named blocks with one row per option."""
    for dot in dots:
        y, e, color = height(dot.block, dot.place, options), dot.estimate, dot.style.color
        axes.bar(ax, e, y, color=color, lw=1.6, zorder=2)
        ax.plot([e.value], [y], ls="", marker=dot.style.marker, color=color, ms=5.5, zorder=3)
    middles = [height(b, 0, options) + (options - 1) / 2 for b in range(len(blocks))]
    end = height(len(blocks) - 1, options - 1, options) + 0.8
    axes.rows_axis(
        ax, middles, [axes.wrapped(block, 18) for block in blocks], (end, -0.8), quantity
    )
    for block in range(1, len(blocks)):
        ax.axhline(height(block, 0, options) - (GAP + 1) / 2, color=GRID, lw=0.8, zorder=0)


@axes.kind("effects", "What the options do", axes.crossed, hero=True, why=True)
def effects(e: GroupEvidence) -> axes.Shown:
    """Pass rate and mean iterations of a crossed group."""
    group, layout = e.group, e.group.crossed
    assert layout is not None
    rates, means = [], []
    for (row, option), name in layout.cells.items():
        summary, style = e.summary(name), group.styles[name]
        rate = summary.pass_rate
        percent = Estimate(100 * rate.value, 100 * rate.low, 100 * rate.high)
        rates.append(Dot(row, option, percent, style))
        means.append(Dot(row, option, summary.restricted_mean, style))
    rows, n = layout.rows, len(layout.options)
    figure = axes.new_figure(1.25 + 0.155 * height(len(rows), 0, n))
    left, right = figure.subplots(1, 2, sharey=True)
    plot_effects(left, rates, rows, n, quantity="trials that pass, %")
    plot_effects(right, means, rows, n, quantity="mean iterations")
    right.tick_params(axis="y", labelleft=False)
    left.set_xlim(-4, 104)
    left.set_xticks([0, 25, 50, 75, 100])
    right.xaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 2, 2.5, 5, 10]))
    right.set_xlim(0, 1.04 * group.cap)
    legend_of(left, options_of(group))
    return figure, (
        f"Left: share of {axes.trials(e)} trials that pass. Right: mean number of iterations;"
        f" failed trials count as {group.cap:,}. Bars: {100 * e.level:g} % intervals (left: Wilson;"
        f" right: MOVER). Circles: {layout.options[0]}."
    )


ACTING = "What agents do, and what they have learned"


@dataclass(frozen=True)
class ActingRow:
    """One configuration; ``first`` if it begins a block."""

    label: str
    acting: Acting
    style: Style
    first: bool


def acting_rows(found: Sequence[Decomposition]) -> list[ActingRow]:
    """The rows of one environment: every strategy with its cells, and softmax last."""
    rows = []
    for d, style in zip(found, styles([d.name for d in found]), strict=True):
        named = {
            "plain": d.strategy,
            "corrected": f"{d.strategy}, corrected",
            "assumed": f"softmax, biased as {d.strategy}",
        }
        here = [(label, d.acting[cell]) for cell, label in named.items() if cell in d.acting]
        rows += [ActingRow(label, a, style, k == 0) for k, (label, a) in enumerate(here)]
    (softmax,) = styles(["softmax"])
    last = next((a for d in found if (a := d.acting.get("reference"))), None)
    return rows + ([ActingRow("softmax", last, softmax, True)] if last else [])


def draw_acting(found: Sequence[Decomposition]) -> axes.Shown:
    """Both scores of every row of one environment with their intervals, joined by a line."""
    rows = acting_rows(found)
    figure = axes.new_figure(
        1.1 + sum(0.13 + 0.16 * axes.line_count(row.label, 24) for row in rows)
    )
    ax = figure.subplots()
    for y, row in enumerate(rows):
        color, behaved, learned = row.style.color, row.acting.behaved, row.acting.learned
        ax.plot([behaved.value, learned.value], [y, y], color=color, lw=1.1, zorder=2)
        look: dict[str, Any] = {"marker": row.style.marker, "mec": color, "ms": 6, "zorder": 3}
        for e, face in ((behaved, PAPER), (learned, color)):
            axes.bar(ax, e, y, color=color, lw=3.4, alpha=0.35, zorder=1)
            ax.plot([e.value], [y], ls="", mfc=face, **look)
        if row.first and y:
            ax.axhline(y - 0.5, color=GRID, lw=0.8, zorder=0)
    labels, ends = [axes.wrapped(row.label, 24) for row in rows], (len(rows) - 0.4, -0.6)
    axes.rows_axis(ax, range(len(rows)), labels, ends, "mean score over training")
    entries = [("while it explores", PAPER), ("without exploration", MUTED)]
    axes.legend_above(ax, axes.marks(entries), columns=2)
    return figure, (
        f"{found[0].environment}. Hollow: mean score of the training episodes, in which the agent"
        " explores. Filled: mean score of the same weights, played without exploration in episodes"
        " of their own. Both are means over the whole training and over trials; the distance"
        f" between them is lost to acting. Shaded: {100 * rows[0].acting.behaved.level:g} %"
        " intervals. “Corrected”: with the per-step ratio; “biased as”: softmax acts, and its"
        " gradient has the bias of the other strategy."
    )
