"""Episodes to the first reward, or iterations until a trial passes, by the size of the task."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trl_explore.names import strategy_label
from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures.axes import handle, legend_above, new_figure, plain_numbers
from trl_explore.report.figures.kind import Kind
from trl_explore.report.figures.panels import fill_panels
from trl_explore.report.sizes import Lines, layout, sentence, size_of
from trl_explore.report.style import INK, styles

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
    if e.group.environment == EPISODES_OF_UNIFORM:
        ends = np.linspace(ticks[0], min(ticks[-1], math.log2(cap / math.log(2))), 50)
        ax.plot(ends, math.log(2) * 2.0**ends, color=INK, lw=1.2, ls=(0, (4, 3)), zorder=2)
    ax.set_title(title, loc="left", color=INK)
    ax.set_yscale("log")
    ax.set_ylim(top=cap * OVER ** (len(panel) + 1))
    ax.set_xlim(ticks[0] - 0.7, ticks[-1] + 0.7)
    ax.grid()
    plain_numbers(ax.yaxis)


def _draw(e: GroupEvidence) -> Figure:
    panels = layout(e.group.configurations)
    names = list(dict.fromkeys(c.strategy for c in e.group.configurations))
    figure = new_figure(1.2 + 3.1 * math.ceil(len(panels) / 2))
    fill_panels(
        figure, list(panels.items()), lambda ax, item: _draw_panel(ax, *item, e), "size",
        _quantity(e),
    )  # fmt: skip
    entries = zip(names, styles(names), strict=True)
    handles = [handle(style, strategy_label(name)) for name, style in entries]
    legend_above(figure.axes[0], handles, columns=3)
    return figure


def _quantity(e: GroupEvidence) -> str:
    """What the iterations of a trial are under the group's stopping rule."""
    if e.group.window == 1:
        return f"episodes to the first score above {e.group.threshold:g}"
    return "iterations until passed"


def _caption(e: GroupEvidence) -> str:
    uniform = ""
    if e.group.environment == EPISODES_OF_UNIFORM:
        uniform = (
            " Dashed: the median of uniformly random actions, 2^size · ln 2; one of the 2^size"
            " sequences of actions has the reward."
        )
    return (
        f"Kaplan–Meier median of the {_quantity(e)}, with its interval. Hollow marks above the"
        f" line: fewer than half of the trials got there within the cap of {e.group.cap:,}."
        f"{uniform} {sentence(e.group.configurations)}"
    )


FIRST_REWARD = Kind(
    "first-reward",
    "How the effort grows with the size",
    lambda e: e.group.sized,
    _draw,
    _caption,
    hero=True,
)
