"""Maps: a plane of two parameters, and where the trials have been."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures import axes
from trl_explore.report.style import INK, MAP, MAP_INKS, MUTED, WIDTH, contrast
from trl_explore.statistics.summary import Summary
from trl_explore.training.diagnostic_quantities import PLANES


def plot_plane(
    ax: Axes,
    values: NDArray[np.float64],
    xs: Sequence[float],
    ys: Sequence[float],
    *,
    x: str,
    y: str,
    scale: tuple[float, float],
    marked: tuple[int, int] | None = None,
) -> None:
    """Draw a map; lighter is better in both themes of the page.

    Every cell shows its number in a contrasting colour, so the map can be read without
    distinguishing colours. Cells without a value are empty.

    Args:
        ax: empty axes.
        values: [len(xs), len(ys)]; NaN: not measured.
        xs: values of the first parameter from left to right.
        ys: values of the second from bottom to top.
        x: name of the first.
        y: name of the second.
        scale: the worst value (dark) and the best value (light).
        marked: the cell that gets a frame.
    """
    worst, best = scale
    for i in range(len(xs)):
        for j in range(len(ys)):
            value = float(values[i, j])
            if not np.isfinite(value):
                continue
            color = cell_color((value - worst) / (best - worst or 1.0))
            ax.add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, fc=color, ec=color, lw=0.3))
            ax.text(
                i, j, f"{value:,.0f}", ha="center", va="center", fontsize=8, color=ink_on(color)
            )
    if marked is not None:
        i, j = marked
        ink = ink_on(cell_color((float(values[i, j]) - worst) / (best - worst or 1.0)))
        ax.add_patch(Rectangle((i - 0.45, j - 0.45), 0.9, 0.9, fc="none", ec=ink, lw=1.6))
    ax.set_xlim(-0.5, len(xs) - 0.5)
    ax.set_ylim(-0.5, len(ys) - 0.5)
    ax.set_xticks(range(len(xs)), [f"{value:g}" for value in xs])
    ax.set_yticks(range(len(ys)), [f"{value:g}" for value in ys])
    ax.set_xlabel(x, color=INK)
    ax.set_ylabel(y, color=INK)
    ax.tick_params(length=0, color=MUTED)
    for spine in ax.spines.values():
        spine.set_visible(False)


def cell_color(share: float) -> str:
    """Colour of a cell, dark blue at 0 to light yellow at 1.

    >>> cell_color(0.0) == MAP[0], cell_color(2.0) == MAP[-1]
    (True, True)
    """
    return MAP[round(float(np.clip(share, 0.0, 1.0)) * (len(MAP) - 1))]


def ink_on(color: str) -> str:
    """Black or white, whichever has more contrast to a colour.

    >>> ink_on(MAP[-1])
    '#101214'
    """
    return max(MAP_INKS, key=lambda ink: contrast(ink, color))


def _plane(
    e: GroupEvidence, title: str, value: Callable[[Summary], float], scale: tuple[float, float]
) -> tuple[Figure, str]:
    """The map of a quantity, and the words on its frame."""
    layout = e.group.plane
    assert layout is not None
    values = np.full((len(layout.xs), len(layout.ys)), np.nan)
    for place, name in layout.cells.items():
        values[place] = value(e.summary(name))
    marked = next((place for place, n in layout.cells.items() if n == layout.reference), None)
    figure = axes.new_figure(0.95 + 0.36 * len(layout.ys))
    ax = figure.subplots()
    plot_plane(
        ax, values, layout.xs, layout.ys, x=layout.x, y=layout.y, scale=scale,
        marked=marked,
    )  # fmt: skip
    ax.set_title(title, loc="left", color=INK)
    name = layout.reference
    return figure, f"Framed: {e.group.labels[name]}, the thesis’s softmax. " if name else ""


@axes.kind("map-pass", "Where trials pass", axes.plane, hero=True)
def passing(e: GroupEvidence) -> axes.Shown:
    """The map of the pass rate."""
    width = max(50 * (s.pass_rate.high - s.pass_rate.low) for s in e.summaries)
    figure, frame = _plane(
        e, "trials that pass, %", lambda s: 100 * s.pass_rate.value, (0.0, 100.0)
    )
    return figure, (
        f"Percentage of {axes.trials(e)} trials that pass; lighter is better. {frame}A cell is"
        f" uncertain by up to ±{width:.0f} points: look at the pattern, not at single cells."
    )


@axes.kind("map-iterations", "How many iterations they take", axes.plane)
def iterations(e: GroupEvidence) -> axes.Shown:
    """The map of the mean iterations."""
    ends = (float(e.group.cap), min(s.restricted_mean.value for s in e.summaries))
    figure, frame = _plane(e, "mean iterations", lambda s: s.restricted_mean.value, ends)
    return figure, (
        "Mean number of iterations to convergence; failed trials count as"
        f" {e.group.cap:,}. Lighter is faster. {frame}"
    )


COLUMNS = 4
"""The number of iterations shown."""
FAINT = 1e-4
"""The smallest share of the frames that has a colour of its own; smaller ones have the same."""


def _names(e: GroupEvidence) -> list[str]:
    """The configurations whose visits were recorded, at most ``NAMED``."""
    return [c.name for c in e.group.configurations if c.name in e.traces.visits][: axes.NAMED]


@axes.kind(
    "visits",
    "Where the trials have been",
    # All maps have the same rows and columns.
    lambda e: len({e.traces.visits[name]["visits"].shape[1:] for name in _names(e)}) == 1,
    recorded=True,
)
def visits(e: GroupEvidence) -> axes.Shown:
    """The shares of the frames in each state, at a few iterations."""

    def reached(name: str) -> str:
        if name not in e.traces.visits:
            return "not recorded"
        cells = e.traces.visits[name]["reached"][-1]
        return f"{(cells > 0).sum()} of {cells.size}"

    plain = PLANES.get(e.group.env_id) is None
    what, place = ("states", "state") if plain else ("cells", "cell of a grid of two features")
    return _draw_visits(e), (
        f"Share of the frames of all trials in each {place}, from iteration 1 to the one over"
        f" the map (logarithmic colours; white: never). Reached by any trial at the end, {what}:"
        f" {axes.each(e, lambda c: reached(c.name))}."
    )


def _draw_visits(e: GroupEvidence) -> Figure:
    names, plane = _names(e), PLANES.get(e.group.env_id)
    x, y = ([f.low, f.high] for f in plane) if plane else ([], [])
    limits = (x[0], x[1], y[0], y[1]) if plane else None
    rows, columns = e.traces.visits[names[0]]["visits"].shape[1:]
    height = min(1.5, max(0.35, WIDTH / (COLUMNS + 1) * rows / columns))
    figure = axes.new_figure(1.3 + (height + 0.25) * len(names))
    grid = figure.subplots(len(names), COLUMNS, squeeze=False)
    image = None
    for line, name in zip(grid, names, strict=True):
        found = e.traces.visits[name]
        for ax in line:
            ax.set_axis_off()
        end = len(found["iteration"]) - 1  # evenly spaced on a logarithmic scale
        chosen = np.unique(np.linspace(0, end, min(COLUMNS, end + 1)).round().astype(int))
        for ax, k in zip(line, chosen.tolist(), strict=False):
            share = found["visits"][k] / found["visits"][k].sum()
            image = ax.imshow(
                np.where(share > 0, share, np.nan), cmap=ListedColormap(MAP), aspect="auto",
                norm=LogNorm(FAINT, 1.0, clip=True), origin="upper" if plane is None else "lower",
                interpolation="nearest", extent=limits,
            )  # fmt: skip
            when = axes.number(float(found["iteration"][k]))
            ax.set_title(when if ax is not line[0] else f"iteration {when}", fontsize=8, color=INK)
            ax.set_axis_on()
            ax.set_xticks(x if line[0] is grid[-1, 0] else [])
            ax.set_yticks(y if ax is line[0] else [])
            ax.tick_params(labelsize=7)
            ax.grid(False)
        line[0].set_ylabel(axes.wrapped(e.group.labels[name], 18), fontsize=8)
    if plane is not None:
        figure.supxlabel(f"across: {plane[0].label}; up: {plane[1].label}", fontsize=9)
    assert image is not None
    bar = figure.colorbar(image, ax=grid, location="bottom", aspect=50, shrink=0.9, pad=0.02)
    bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: axes.number(value)))
    bar.set_label("share of the frames so far", fontsize=9)
    return figure
