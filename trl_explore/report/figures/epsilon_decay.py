"""ε by iteration, for decaying rates: ε(i) = rate^i (figure 2.5 of the thesis)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from trl_explore.report.figures.axes import handle, legend_above, plain_numbers
from trl_explore.report.style import Style

MARKS = 6


def plot_epsilon(
    ax: Axes,
    rates: Sequence[float],
    styles: Sequence[Style],
    *,
    iterations: int,
    emphasised: float | None = None,
) -> None:
    """Draw ε(i) = rate^i, the share of actions drawn at random, for several rates.

    Args:
        ax: empty axes.
        rates: decay rates in [0, 1].
        styles: one for each rate.
        iterations: where the axis ends.
        emphasised: the rate that is drawn thick.

    """
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
