"""The distribution of one quantity: one row per configuration, one point per trial."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures import axes
from trl_explore.report.style import GRID, INK, MUTED, PAPER, Style
from trl_explore.report.table_formats import span
from trl_explore.statistics.outcomes import Outcomes, lower_median

RASTER_FROM = 400
"""From this number of points per row, points are drawn as an image to keep the SVG small."""
RASTER_FROM_ALL = 1000
"""The same for all rows together."""
SPREAD = 0.28
BINS = 50
SHAPED_FROM = 100
"""From this number of points per row, the cloud takes the shape of the distribution."""


@dataclass(frozen=True, eq=False)
class Row:
    """The trials of one configuration: ``values`` and ``status`` [n]."""

    label: str
    values: NDArray[np.float64]
    status: NDArray[np.str_]
    style: Style


def plot_trials(
    ax: Axes,
    rows: Sequence[Row],
    *,
    quantity: str,
    of: str | None = None,
    line: tuple[float, str] | None = None,
    may_be_log: bool = True,
) -> None:
    """Draw one row of points per configuration, from top to bottom.

    Filled points are trials that converged, hollow points trials that were stopped at the cap,
    crosses trials that diverged; values that are not finite are left out. A bar below the points
    shows the median and the middle half; the number of trials that passed is on the right.

    Args:
        ax: empty axes.
        rows: configurations.
        quantity: name and unit of the horizontal axis.
        of: name of the vertical axis, if rows are values of one parameter.
        line: value and label of a vertical line: the threshold, or the cap.
        may_be_log: use a logarithmic axis if the values span much.
    """
    present = set()
    raster = sum(len(row.values) for row in rows) > RASTER_FROM_ALL
    for y, row in enumerate(rows):
        present |= _points(ax, row, y, raster)
        values = row.values[np.isfinite(row.values)]
        if len(values) > 1:
            low, middle, high = np.quantile(values, [0.25, 0.5, 0.75], method="inverted_cdf")
            look: dict[str, Any] = {"color": INK, "zorder": 4}
            ax.plot([low, high], [y + 0.41] * 2, lw=1.6, solid_capstyle="butt", **look)
            ax.plot([middle], [y + 0.41], marker="|", ms=8, mew=1.8, **look)
        passed = int((row.status == "converged").sum())
        ax.text(
            1.015, y, f"{passed}/{len(row.values)}", transform=ax.get_yaxis_transform(),
            va="center", ha="left", fontsize=8, color=INK,
        )  # fmt: skip
    if rows:
        ax.text(
            1.015, -0.62, "passed", transform=ax.get_yaxis_transform(),
            va="center", ha="left", fontsize=8, color=MUTED,
        )  # fmt: skip
    log = may_be_log and axes.spans_much([row.values for row in rows])
    ax.set_xscale("log" if log else "linear")
    handles = _legend(present)
    if line is not None:
        ax.axvline(line[0], color=INK, lw=1.0, ls=axes.DASHED, zorder=1)
        handles.append(Line2D([], [], color=INK, lw=1.0, ls=axes.DASHED, label=line[1]))
    labels = [axes.wrapped(row.label) for row in rows]
    quantity += " (logarithmic)" if log else ""
    axes.rows_axis(ax, range(len(rows)), labels, (len(rows) - 0.4, -0.9), quantity)
    ax.hlines(
        np.arange(len(rows) - 1) + 0.55, 0, 1, transform=ax.get_yaxis_transform(),
        color=GRID, lw=0.6, zorder=0,
    )  # fmt: skip
    ax.set_ylabel(of or "")
    axes.legend_above(ax, handles, columns=2)


def spread(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Deterministic vertical offsets in [-1, 1] [n] that separate neighbouring points.

    The k-th smallest value gets the k-th number of van der Corput's sequence.

    >>> spread(np.array([5.0, 7.0, 6.0])).tolist()
    [0.0, 0.5, -0.5]
    """
    order = np.argsort(values, kind="stable")
    k = np.arange(1, len(values) + 1)
    sequence, scale = np.zeros(len(values)), 0.5
    while k.any():
        sequence += scale * (k & 1)
        k, scale = k >> 1, scale / 2
    offsets = np.empty(len(values))
    offsets[order] = 2.0 * sequence - 1.0
    return offsets


def crowding(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Width of the cloud of points at each value [n], in (0, 1]; 1 for few points.

    For many points it is √(count of the value's bin / largest count) over ``BINS`` equal bins: the
    cloud shows the density, and single points remain visible.
    """
    if len(values) <= SHAPED_FROM or values.min() == values.max():
        return np.ones(len(values))
    edges = np.linspace(values.min(), values.max(), BINS + 1)[1:-1]
    place = np.searchsorted(edges, values, side="right")
    counts = np.bincount(place, minlength=BINS)
    return np.sqrt(counts[place] / counts.max())


def _points(ax: Axes, row: Row, y: int, raster: bool) -> set[str]:
    """Draw the points of a row; return the statuses that occur."""
    finite = np.isfinite(row.values)
    values = np.where(finite, row.values, 0.0)
    heights = y + SPREAD * spread(values) * crowding(values)
    many = len(row.values) > RASTER_FROM
    size = 22.0 if len(row.values) <= 60 else 12.0 if not many else 5.0
    shown = set()
    for status in ("capped", "converged", "diverged"):
        mask = finite & (row.status == status)
        if not mask.any():
            continue
        shown.add(status)
        ax.scatter(
            row.values[mask],
            heights[mask],
            s=size,
            marker="x" if status == "diverged" else row.style.marker,
            facecolor={"converged": row.style.color, "capped": PAPER}.get(status, INK),
            edgecolor=None if status == "diverged" else row.style.color,
            linewidth=0.9 if not many else 0.4,
            alpha=0.85 if not many else 0.3,
            zorder=3,
            rasterized=many or raster,
            label=status,
        )
    return shown


def _legend(present: set[str]) -> list[Line2D]:
    entries = {
        "converged": ("converged: passed the task", "o", MUTED),
        "capped": ("stopped at the cap, not passed", "o", PAPER),
        "diverged": ("diverged", "x", INK),
    }
    handles = [
        Line2D([], [], ls="", marker=marker, mfc=face, mec=MUTED, ms=5, label=label)
        for status, (label, marker, face) in entries.items()
        if status in present
    ]
    bar = Line2D([], [], color=INK, lw=1.6, marker="|", ms=8, mew=1.8)
    bar.set_label("median and middle half")
    return [*handles, bar]


def _draw(
    e: GroupEvidence,
    values: Callable[[Outcomes], tuple[Outcomes, NDArray[Any]]],
    quantity: str,
    line: tuple[float, str] | None = None,
    *,
    may_be_log: bool = True,
) -> Figure:
    """Draw one row of points for each configuration that has values."""
    rows = [
        Row(e.group.short(c.name), numbers.astype(np.float64), shown.status, e.group.styles[c.name])
        for c in e.group.configurations
        for shown, numbers in [values(c)]
        if len(shown)
    ]
    figure = axes.new_figure(
        1.3 + sum(max(0.42, 0.17 * axes.line_count(row.label)) for row in rows)
    )
    plot_trials(
        figure.subplots(), rows, quantity=quantity, of=e.group.parameter, line=line,
        may_be_log=may_be_log,
    )  # fmt: skip
    return figure


@axes.kind(
    "score",
    "Final score of every trial",
    axes.few,
    thesis={"thesis": "3.1", "epsilon_grid": "2.1", "decay_grid": "2.3"},
)
def score(e: GroupEvidence) -> axes.Shown:
    """The final scores, and the threshold."""
    learned, threshold, window = e.group.did == "learned", e.group.threshold, e.group.window
    quantity = f"mean score of the last {window} episodes"
    caption = (
        f"One point per trial. {axes.passed(e)} A trial stops as soon as its score exceeds"
        f" {threshold:g}, so passing trials lie just above the line, except those that"
        f" had exceeded it before their {window}th episode."
    )
    if learned:
        quantity = "mean score of the final policy, without exploration"
        caption = f"One point per trial: its policy, played without exploration. {axes.passed(e)}"
    line = threshold, f"passes above {threshold:g}"
    return _draw(e, lambda c: (c, c.score), quantity, line, may_be_log=False), caption


@axes.kind(
    "iterations",
    "Iterations of every trial",
    axes.few,
    thesis={"thesis": "3.2", "decay_grid": "2.2"},
)
def iterations(e: GroupEvidence) -> axes.Shown:
    """The iterations to convergence, and the cap."""

    def median(c: Outcomes) -> str:
        middle = lower_median(c.durations, c.converged)
        return axes.number(middle) if np.isfinite(middle) else "not reached"

    line = e.group.cap, f"cap: {e.group.cap:,} iterations"
    return _draw(e, lambda c: (c, c.durations), "iterations to convergence", line), (
        f"Hollow points: trials stopped at the cap of {e.group.cap:,} iterations. They"
        f" would have needed more iterations, or would never have {e.group.did}."
        f" Medians{axes.by(e)}: {axes.each(e, median)}."
    )


@axes.kind(
    "seconds",
    "Seconds of single trials",
    lambda e: any(len(e.group.timed(c)[1]) for c in e.group.configurations),
    thesis={"thesis": "3.3", "decay_grid": "2.4"},
)
def seconds(e: GroupEvidence) -> axes.Shown:
    """The seconds of trials that were timed alone."""
    timed = {c.name: e.group.timed(c)[1] for c in e.group.configurations}
    counts = span({len(s) for s in timed.values()} - {0})

    def mean(c: Outcomes) -> str:
        return f"{timed[c.name].mean():.3g} s" if len(timed[c.name]) else "not timed"

    return _draw(e, e.group.timed, "seconds of a trial run alone"), (
        f"Each trial was run alone, in random order, after a warm-up; {counts} trials per"
        f" configuration. Means{axes.by(e)}: {axes.each(e, mean)}. Seconds depend on program and"
        " machine: an iteration has a fixed cost in addition to the cost of its frames, which slows"
        " down trials with many short episodes. The figure of frames does not depend on the"
        " machine."
    )


@axes.kind("frames", "Frames of every trial", axes.few)
def frames(e: GroupEvidence) -> axes.Shown:
    """The frames until each trial stopped."""
    return _draw(e, lambda c: (c, c.frames), "frames until the trial stopped"), (
        "Environment steps until a trial stopped: a cost of learning that does not depend on the"
        " machine. Failed trials with short episodes use few frames."
        f" Means{axes.by(e)}: {axes.each(e, lambda c: f'{c.frames.mean():,.0f}')}."
    )
