"""ε by iteration for several decay rates: ε(i) = rate^i (figure 2.5 of the thesis)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures.axes import handle, legend_above, new_figure, plain_numbers
from trl_explore.report.figures.kind import Kind
from trl_explore.report.style import Style

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
    plain_numbers(ax.xaxis)
    handles = [handle(s, f"{r:g}") for r, s in zip(rates, styles, strict=True)]
    legend_above(ax, handles, columns=min(4, len(rates)), title="decay rate")


def _rates(e: GroupEvidence) -> dict[float, str]:
    """Decay rate -> name of the configuration, for decaying ε-greedy."""
    return {
        float(c.parameters["decay"]): c.name
        for c in e.group.configurations
        if c.strategy == "decaying_epsilon_greedy"
        and isinstance(c.parameters.get("decay"), int | float)
    }


def _draw(e: GroupEvidence) -> Figure:
    rates = _rates(e)
    figure = new_figure(3.2)
    looks = [e.group.styles[name] for name in rates.values()]
    end = min(e.group.cap, 600)
    plot_epsilon(figure.subplots(), list(rates), looks, iterations=end, emphasised=CHOSEN)
    return figure


EPSILON = Kind(
    "epsilon",
    "ε under the decay rates",
    lambda e: e.group.experiment == "decay_grid" and len(_rates(e)) > 0,
    _draw,
    lambda e: (
        f"Probability of a random action in each iteration. The thesis chose {CHOSEN}"
        f" (thick line), which halves ε every {np.log(0.5) / np.log(CHOSEN):.0f} iterations."
    ),
    thesis={"decay_grid": "2.5"},
)
