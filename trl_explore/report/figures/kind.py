"""What a kind of figure is, and what the conditions and captions of several of them share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from matplotlib.figure import Figure

from trl_explore.report.evidence import GroupEvidence
from trl_explore.statistics.outcomes import Outcomes

FEW = 16
"""Most configurations of a figure with one row, or panel, for each."""
NAMED = 9
"""Most configurations that a caption names."""


@dataclass(frozen=True)
class Kind:
    """A kind of figure: when there is one, how it is drawn, and what is said about it.

    Attributes:
        name: unique; part of the names of its files.
        title: for readers.
        applies: whether a group has this figure.
        draw: the figure.
        caption: what to see in it, in words made from its numbers; plain text.
        thesis: experiment -> number of the thesis's figure that shows the same.
        hero: whether the first such figure may stand beside the answer.
        recorded: whether it shows what was recorded along the runs.
        why: whether the section on the bias shows it.

    """

    name: str
    title: str
    applies: Callable[[GroupEvidence], bool]
    draw: Callable[[GroupEvidence], Figure]
    caption: Callable[[GroupEvidence], str]
    thesis: Mapping[str, str] = field(default_factory=dict)
    hero: bool = False
    recorded: bool = False
    why: bool = False


def few(e: GroupEvidence) -> bool:
    """Whether there is room for a row or a panel of every configuration."""
    return e.group.plane is None and len(e.group.configurations) <= FEW


def crossed(e: GroupEvidence) -> bool:
    """Whether rows are crossed with options."""
    return e.group.crossed is not None


def plane(e: GroupEvidence) -> bool:
    """Whether the configurations are points of a plane."""
    return e.group.plane is not None


def plain(e: GroupEvidence) -> bool:
    """Whether every configuration stands beside every other one."""
    return not crossed(e) and not plane(e)


def whole_study(e: GroupEvidence) -> bool:
    """Whether it is a plain group, and no grid over one parameter."""
    return plain(e) and not e.group.is_grid


def trials(e: GroupEvidence) -> str:
    """How many trials the configurations have."""
    counts = {len(c) for c in e.group.configurations}
    return f"{min(counts):,}" if len(counts) == 1 else f"{min(counts):,} to {max(counts):,}"


def each(e: GroupEvidence, text: Callable[[Outcomes], str]) -> str:
    """A text on each of the first configurations."""
    shown = e.group.configurations[:NAMED]
    parts = [f"{e.group.short(c.name)}: {text(c)}" for c in shown]
    return "; ".join(parts) + (" …" if len(e.group.configurations) > NAMED else "")


def by(e: GroupEvidence) -> str:
    """The parameter that a list of configurations is ordered by, if there is one."""
    return f" by {e.group.parameter}" if e.group.parameter else ""


def passed(e: GroupEvidence) -> str:
    """How many trials of each configuration passed."""
    return f"Passed{by(e)}: {each(e, lambda c: f'{int(c.converged.sum())} of {len(c)}')}."
