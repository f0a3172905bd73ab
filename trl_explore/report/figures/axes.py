"""A kind of figure; axes, legends and panels that several kinds share."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import ArrayLike

from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.style import INK, MUTED, WIDTH, Style
from trl_explore.report.table_formats import span
from trl_explore.statistics.estimates import Estimate
from trl_explore.statistics.outcomes import Outcomes

FEW = 16
"""Most configurations of a figure with one row or panel each."""
NAMED = 9
"""Most configurations that a caption names."""


DASHED = (0, (4, 3))
"""The line style of thresholds and caps."""

Shown = tuple[Figure, str]
"""A figure, and what it shows, with its numbers, as plain text."""


@dataclass(frozen=True)
class FigureKind:
    """A kind of figure: its condition, and its drawing with its caption.

    Attributes:
        name: unique; part of the names of its files.
        applies: whether a group has this figure.
        draw: the figure of a group with its caption.
        thesis: experiment -> number of the same figure in the thesis.
        hero: whether the first such figure may appear next to the answer.
        recorded: whether it shows what was recorded during training.
        why: whether it appears in the section on the bias.
    """

    name: str
    title: str
    applies: Callable[[GroupEvidence], bool]
    draw: Callable[[GroupEvidence], Shown]
    thesis: Mapping[str, str] = field(default_factory=dict)
    hero: bool = False
    recorded: bool = False
    why: bool = False


def kind(
    name: str, title: str, applies: Callable[[GroupEvidence], bool], **facts: Any
) -> Callable[[Callable[[GroupEvidence], Shown]], FigureKind]:
    """Make a drawing function a kind of figure."""
    return lambda draw: FigureKind(name, title, applies, draw, **facts)


def few(e: GroupEvidence) -> bool:
    """Whether there is room for a row or panel per configuration."""
    return e.group.plane is None and len(e.group.configurations) <= FEW


def crossed(e: GroupEvidence) -> bool:
    """Whether rows are crossed with options."""
    return e.group.crossed is not None


def plane(e: GroupEvidence) -> bool:
    """Whether the configurations are points of a plane."""
    return e.group.plane is not None


def plain(e: GroupEvidence) -> bool:
    """Whether the configurations have no layout: not crossed, no plane, not by size."""
    return not crossed(e) and not plane(e) and not e.group.sized


def whole_study(e: GroupEvidence) -> bool:
    """Whether it is a plain group and not a grid over one parameter."""
    return plain(e) and not e.group.is_grid


def trials(e: GroupEvidence) -> str:
    """How many trials the configurations have."""
    return span(len(c) for c in e.group.configurations)


def each(e: GroupEvidence, text: Callable[[Outcomes], str]) -> str:
    """A text about each of the first ``NAMED`` configurations."""
    shown = e.group.configurations[:NAMED]
    parts = [f"{e.group.short(c.name)}: {text(c)}" for c in shown]
    return "; ".join(parts) + (" …" if len(e.group.configurations) > NAMED else "")


def by(e: GroupEvidence) -> str:
    """The parameter that a list of configurations is ordered by, if there is one."""
    return f" by {e.group.parameter}" if e.group.parameter else ""


def passed(e: GroupEvidence) -> str:
    """How many trials of each configuration passed."""
    counts = each(e, lambda c: f"{int(c.converged.sum())} of {len(c)}")
    return f"{e.group.did.capitalize()}{by(e)}: {counts}."


LOG_FROM = 30.0
"""Values that span more than this factor are drawn on a logarithmic axis."""


def new_figure(height: float) -> Figure:
    """An empty figure of the report's width and a height in inches."""
    figure = Figure(figsize=(WIDTH, height))
    figure.set_layout_engine("constrained", w_pad=0.06, h_pad=0.06)
    return figure


def spans_much(values: Sequence[ArrayLike]) -> bool:
    """Whether values are all positive and span enough for a logarithmic axis."""
    flat = np.concatenate([np.asarray(v, dtype=np.float64).ravel() for v in values])
    flat = flat[np.isfinite(flat)]
    return len(flat) > 0 and flat.min() > 0 and flat.max() / flat.min() > LOG_FROM


def number(value: float) -> str:
    """A number as a tick label, without an exponent: 12,000 or 0.05."""
    if value and abs(value) < 1:
        return f"{value:.6f}".rstrip("0").rstrip(".")
    return f"{value:,.0f}" if float(value).is_integer() else f"{value:,g}"


def plain_numbers(axis: Any) -> None:
    """Write the ticks of an axis, linear or logarithmic, as plain numbers."""
    if axis.get_scale() == "log":
        low, high = sorted(axis.get_view_interval())
        decades = np.log10(high / low) if low > 0 else 9
        subs = (1.0, 2.0, 5.0) if decades < 1.3 else (1.0, 3.0) if decades < 2.6 else (1.0,)
        axis.set_major_locator(LogLocator(subs=subs))
        axis.set_minor_formatter(NullFormatter())
        if decades > 6:
            axis.set_major_formatter(LogFormatter())
            return
    else:
        axis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 2.5, 5, 10]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: number(value)))


def few_ticks(axis: Any) -> None:
    """Set fewer ticks for a narrow panel, and even fewer for long numbers."""
    longest = max(abs(value) for value in axis.get_view_interval())
    nbins = 3 if longest >= 5000 else 5
    axis.set_major_locator(MaxNLocator(nbins=nbins, steps=[1, 2, 2.5, 5, 10]))


def wrapped(label: str, width: int = 21, lines: int = 3) -> str:
    r"""A label wrapped to at most ``lines`` lines of ``width`` characters; the rest is cut off.

    >>> wrapped("softmax, baseline = 20, lr = 0.05")
    'softmax,\nbaseline = 20,\nlr = 0.05'
    """
    # No line break around an equals sign.
    kept = label.replace(" = ", "\u00a0=\u00a0")
    parts = textwrap.wrap(kept, width, break_long_words=True, break_on_hyphens=False)
    if len(parts) > lines:
        parts = [*parts[: lines - 1], parts[lines - 1][: width - 1] + "…"]
    return "\n".join(part.replace("\u00a0", " ") for part in parts)


def line_count(label: str, width: int = 21) -> int:
    """Number of lines of the wrapped label."""
    return wrapped(label, width).count("\n") + 1


def handle(style: Style, label: str) -> Line2D:
    """A legend entry in the style of a configuration."""
    return Line2D([], [], color=style.color, marker=style.marker, ls=style.line, label=label)


def rows_axis(
    ax: Axes, at: Sequence[float], labels: Sequence[str], ends: tuple[float, float], quantity: str
) -> None:
    """Name the rows at heights, from top to bottom, and the quantity on the horizontal axis."""
    ax.set_yticks(at, labels)
    ax.set_ylim(*ends)
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
    ax.grid(axis="x")
    ax.set_xlabel(quantity, color=INK)
    plain_numbers(ax.xaxis)


def bar(ax: Axes, e: Estimate, y: float, **look: Any) -> None:
    """Draw an interval in a row, if it is known."""
    if np.isfinite([e.low, e.high]).all():
        ax.plot([e.low, e.high], [y, y], **look)


def marks(entries: Sequence[tuple[str, str]]) -> list[Line2D]:
    """Legend entries of points with a face: label and colour."""
    return [
        Line2D([], [], ls="", color=MUTED, marker="o", mfc=face, ms=6, label=label)
        for label, face in entries
    ]


def legend_above(
    ax: Axes, handles: Sequence[Line2D], columns: int, title: str | None = None
) -> None:
    """Draw a legend above the figure, where it covers nothing."""
    figure = ax.figure
    figure.legend(
        handles=list(handles),
        loc="outside upper left",
        borderaxespad=0.0,
        ncol=columns,
        title=title,
        alignment="left",
        handlelength=3.2,
        columnspacing=1.4,
        labelcolor=INK,
    )
