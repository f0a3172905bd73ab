"""What was recorded along the runs: one figure for each entry of ``DIAGNOSTICS``."""

from __future__ import annotations

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
"""The quantities that say how far μ was from π."""
HOW = (
    " Median and middle half of the trials, averaged over 20 iterations; one that stopped keeps its"
    " last value."
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
    """The mean of each curve, of the first options where rows are crossed with options."""
    layout = e.group.crossed
    if layout is None:
        labels, option = e.group.labels, ""
    else:
        labels = {n: layout.rows[r] for (r, o), n in sorted(layout.cells.items()) if o == 0}
        option = f", {layout.options[0]}"
    texts = [f"{labels[n]}: {_short(curves[n].level)}" for n in labels if n in curves]
    return f" Mean of the line over all iterations{option}: {'; '.join(texts[:NAMED])}."


def _short(value: float) -> str:
    """A number in two digits, without powers of ten.

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

PAIR = {quantity.policy: name for name, quantity in DIAGNOSTICS.items() if quantity.policy}
"""The entropies: policy -> quantity."""
FIRST = DIAGNOSTICS[PAIR["π"]]


def _draw_entropy(e: GroupEvidence) -> Figure:
    """The entropies of π (left) and μ (right), in pairs of panels."""
    group = e.group
    curves = {policy: e.traces.diagnostics.get(name, {}) for policy, name in PAIR.items()}
    panels = [
        Panel(f"{panel.title}: {policy}" if panel.title else policy, panel.names)
        for panel in panels_of(group)
        for policy in PAIR
    ]
    limits = limits_of([c for found in curves.values() for c in found.values()])

    def draw(ax: Axes, panel: Panel) -> None:
        found = curves[panel.title[-1]]
        mine = [(found[n], group.styles[n]) for n in panel.names if n in found]
        if mine:
            plot_curves(ax, mine, title=panel.title, limits=limits)

    return draw_panels(group, draw, panels, "iteration", FIRST.axis)


ENTROPY = Kind(
    "entropy",
    FIRST.title,
    lambda e: _recorded(PAIR["π"], e),
    _draw_entropy,
    lambda e: f"{FIRST.caption}{HOW}",
    recorded=True,
)
