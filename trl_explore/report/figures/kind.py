"""A kind of figure; conditions and caption parts that several kinds share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from matplotlib.figure import Figure

from trl_explore.report.evidence import GroupEvidence
from trl_explore.statistics.outcomes import Outcomes

FEW = 16
"""Most configurations of a figure with one row or panel each."""
NAMED = 9
"""Most configurations that a caption names."""


@dataclass(frozen=True)
class Kind:
    """A kind of figure: its condition, its drawing and its caption.

    Attributes:
        name: unique; part of the names of its files.
        title: for readers.
        applies: whether a group has this figure.
        draw: the figure.
        caption: what the figure shows, with its numbers; plain text.
        thesis: experiment -> number of the same figure in the thesis.
        hero: whether the first such figure may appear next to the answer.
        recorded: whether it shows what was recorded during training.
        why: whether it appears in the section on the bias.

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
    counts = {len(c) for c in e.group.configurations}
    return f"{min(counts):,}" if len(counts) == 1 else f"{min(counts):,} to {max(counts):,}"


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
    return f"Passed{by(e)}: {each(e, lambda c: f'{int(c.converged.sum())} of {len(c)}')}."
