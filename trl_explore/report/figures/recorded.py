"""Diagnostics recorded during training: one figure for each entry of ``DIAGNOSTICS``."""

from __future__ import annotations

from dataclasses import replace

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trl_explore.report.curves import Curve
from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures.axes import spans_much
from trl_explore.report.figures.kind import NAMED, Kind, crossed
from trl_explore.report.figures.panels import (
    Panel,
    draw_panels,
    limits_of,
    panels_of,
    plot_curves,
)
from trl_explore.training.columns import DIAGNOSTICS, Diagnostic

FEWER = 12
"""Most configurations whose curves share a panel."""
WHY = ("kl", "effective_sample_size", "ratio_mean")
"""The quantities that measure the distance between μ and π."""
HOW = (
    " Line: median over trials; band: middle half; values averaged over 20 iterations."
    " Stopped trials keep their last value."
)


def _recorded(name: str, e: GroupEvidence) -> bool:
    readable = crossed(e) or len(e.group.configurations) <= FEWER
    return readable and name in e.traces.diagnostics


def _draw(e: GroupEvidence, name: str, quantity: Diagnostic) -> Figure:
    group, curves = e.group, e.traces.diagnostics[name]
    log = quantity.may_be_log and spans_much([curve.mean for curve in curves.values()])
    limits = limits_of(
        list(curves.values()), line=quantity.line, log=log, from_zero=quantity.from_zero
    )
    if quantity.bounds == (0.0, 1.0):
        limits = (0.0, 1.04)

    def draw(ax: Axes, panel: Panel) -> None:
        mine = [(curves[n], group.styles[n]) for n in panel.names if n in curves]
        if mine:
            plot_curves(ax, mine, title=panel.title, line=quantity.line,
                        limits=limits, log=log)  # fmt: skip

    axis = quantity.axis + (" (logarithmic)" if log else "")
    return draw_panels(group, draw, panels_of(group), "iteration", axis)


def _means(e: GroupEvidence, curves: dict[str, Curve]) -> str:
    """The mean of each curve; in a crossed group, only of the first option."""
    layout = e.group.crossed
    if layout is None:
        labels, option = e.group.labels, ""
    else:
        labels = {n: layout.rows[r] for (r, o), n in sorted(layout.cells.items()) if o == 0}
        option = f", {layout.options[0]}"
    texts = [f"{labels[n]}: {_short(curves[n].level)}" for n in labels if n in curves]
    return f" Mean of each line over all iterations{option}: {'; '.join(texts[:NAMED])}."


def _short(value: float) -> str:
    """A number with two digits, without an exponent.

    >>> _short(3.2e-10), _short(0.0966), _short(6620.0)
    ('< 0.001', '0.097', '6,620')
    """
    if 0 < abs(value) < 1e-3:
        return "< 0.001"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.2g}"


def _kind(name: str, quantity: Diagnostic) -> Kind:
    return Kind(
        name,
        quantity.title,
        lambda e: _recorded(name, e),
        lambda e: _draw(e, name, quantity),
        lambda e: f"{quantity.caption}{HOW}{_means(e, e.traces.diagnostics[name])}",
        recorded=True,
        why=name in WHY,
    )


DIAGNOSTIC_KINDS = tuple(_kind(name, q) for name, q in DIAGNOSTICS.items() if not q.policy)

ENTROPIES = tuple(name for name, quantity in DIAGNOSTICS.items() if quantity.policy)
FIRST = DIAGNOSTICS[ENTROPIES[0]]


def _draw_entropy(e: GroupEvidence) -> Figure:
    """Draw the entropies of π (left) and μ (right) in pairs of panels."""
    group = e.group
    panels = [
        replace(
            panel,
            title=f"{panel.title}: {DIAGNOSTICS[name].policy}".removeprefix(": "),
            quantity=name,
        )
        for panel in panels_of(group)
        for name in ENTROPIES
    ]
    found = {name: e.traces.diagnostics.get(name, {}) for name in ENTROPIES}
    limits = limits_of([curve for curves in found.values() for curve in curves.values()])

    def draw(ax: Axes, panel: Panel) -> None:
        curves = found[panel.quantity]
        mine = [(curves[n], group.styles[n]) for n in panel.names if n in curves]
        if mine:
            plot_curves(ax, mine, title=panel.title, limits=limits)

    return draw_panels(group, draw, panels, "iteration", FIRST.axis)


ENTROPY = Kind(
    "entropy",
    FIRST.title,
    lambda e: _recorded(ENTROPIES[0], e),
    _draw_entropy,
    lambda e: f"{FIRST.caption}{HOW}",
    recorded=True,
)
