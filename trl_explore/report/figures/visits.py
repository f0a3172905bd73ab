"""Where the trials have been: one row of maps per configuration, one column per iteration."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures.axes import new_figure, number, wrapped
from trl_explore.report.figures.kind import NAMED, Kind, each
from trl_explore.report.style import INK, MAP, WIDTH
from trl_explore.training.columns import PLANES

COLUMNS = 4
"""The number of iterations shown."""
FAINT = 1e-4
"""The smallest share of the frames that has a colour of its own; smaller ones have the same."""


def _names(e: GroupEvidence) -> list[str]:
    """The configurations whose visits were recorded, at most ``NAMED``."""
    return [c.name for c in e.group.configurations if c.name in e.traces.visits][:NAMED]


def _chosen(iterations: NDArray[np.int64]) -> list[int]:
    """Places of iterations that are about evenly spaced on a logarithmic scale."""
    count = min(COLUMNS, len(iterations))
    return np.unique(np.linspace(0, len(iterations) - 1, count).round().astype(int)).tolist()


def _draw(e: GroupEvidence) -> Figure:
    names, plane = _names(e), PLANES.get(e.group.environment)
    rows, columns = e.traces.visits[names[0]]["visits"].shape[1:]
    height = min(1.5, max(0.35, WIDTH / (COLUMNS + 1) * rows / columns))
    figure = new_figure(1.3 + (height + 0.25) * len(names))
    axes = figure.subplots(len(names), COLUMNS, squeeze=False)
    image = None
    for line, name in zip(axes, names, strict=True):
        found = e.traces.visits[name]
        for ax in line:
            ax.set_axis_off()
        for ax, k in zip(line, _chosen(found["iteration"]), strict=False):
            share = found["visits"][k] / found["visits"][k].sum()
            image = ax.imshow(
                np.where(share > 0, share, np.nan), cmap=ListedColormap(MAP), aspect="auto",
                norm=LogNorm(FAINT, 1.0, clip=True), origin="upper" if plane is None else "lower",
                interpolation="nearest",
            )  # fmt: skip
            ax.set_title(number(float(found["iteration"][k])), fontsize=8, color=INK)
            ax.set_axis_on()
            ax.set_xticks([])
            ax.set_yticks([])
            ax.grid(False)
        line[0].set_ylabel(wrapped(e.group.labels[name], 18), fontsize=8)
    if plane is not None:
        figure.supxlabel(f"across: {plane[0].label}; up: {plane[1].label}", fontsize=9)
    assert image is not None
    bar = figure.colorbar(image, ax=axes, location="bottom", aspect=50, shrink=0.9, pad=0.02)
    bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: number(value)))
    bar.set_label("share of the frames so far", fontsize=9)
    return figure


def _caption(e: GroupEvidence) -> str:
    def reached(name: str) -> str:
        cells = e.traces.visits[name]["reached"][-1]
        return f"{(cells > 0).sum()} of {cells.size}" if name in e.traces.visits else "not recorded"

    what = "states" if PLANES.get(e.group.environment) is None else "cells"
    return (
        "Share of the frames of all trials in each state, from the first iteration to the one over"
        f" the map (logarithmic colours; white: never). Reached by any trial at the end, {what}:"
        f" {each(e, lambda c: reached(c.name))}."
    )


VISITS = Kind(
    "visits",
    "Where the trials have been",
    lambda e: len(_names(e)) > 0 and _one_shape(e),
    _draw,
    _caption,
    recorded=True,
)


def _one_shape(e: GroupEvidence) -> bool:
    """Whether all maps have the same rows and columns."""
    return len({e.traces.visits[name]["visits"].shape[1:] for name in _names(e)}) == 1
