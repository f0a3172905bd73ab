"""The figures of the report; each file holds conditions, drawings and captions of similar ones.

A new figure is a function with the decorator :func:`~trl_explore.report.figures.axes.kind`, and
one line in ``KINDS``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from trl_explore.report.decomposition import Decomposition
from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.figures import by_parameter, differences, learning, maps, survival, trials
from trl_explore.report.figures.axes import FigureKind
from trl_explore.report.image_files import drawn_files
from trl_explore.report.style import visual_language

KINDS: tuple[FigureKind, ...] = (
    maps.passing,
    maps.iterations,
    by_parameter.first_reward,
    differences.effects,
    survival.panels,
    survival.curves,
    survival.learned_panels,
    survival.learned,
    trials.score,
    trials.iterations,
    trials.seconds,
    trials.frames,
    by_parameter.epsilon,
    learning.learning,
    learning.panels,
    learning.evaluation,
    survival.frames,
    differences.forest,
    by_parameter.power,
    *learning.DIAGNOSTIC_KINDS,
    learning.entropy,
    maps.visits,
)
"""In the order in which a section shows them."""


@dataclass(frozen=True)
class Picture:
    """A figure of the report; ``thesis`` is the number of the same figure there, if it exists."""

    id: str
    title: str
    caption: str
    alt: str
    svg: str
    png: bytes
    pdf: bytes
    thesis: str | None = None


@dataclass(frozen=True, kw_only=True)
class Drawn(Picture):
    """A figure of a group."""

    kind: FigureKind


def draw_all(evidence: GroupEvidence) -> Iterator[Drawn]:
    """Draw every figure of a group, in order."""
    group = evidence.group
    for kind in KINDS:
        if not kind.applies(evidence):
            continue
        with visual_language():
            figure, caption = kind.draw(evidence)
            files = drawn_files(figure)
        thesis = kind.thesis.get(group.experiment)
        number = f"{thesis}-" if thesis else ""
        yield Drawn(
            id=f"{group.id}-{number.replace('.', '_')}{kind.name}",
            title=kind.title,
            kind=kind,
            caption=caption,
            alt=f"{kind.title}, {group.title}. {caption}",
            thesis=thesis,
            **files,
        )


def draw_why(found: Sequence[Decomposition]) -> Iterator[Picture]:
    """One figure for every environment in which the parts of a difference are known."""
    for k, environment in enumerate(dict.fromkeys(d.environment for d in found)):
        here = [d for d in found if d.environment == environment]
        if not differences.acting_rows(here):
            continue
        with visual_language():
            figure, caption = differences.draw_acting(here)
            files = drawn_files(figure)
        title = differences.ACTING
        yield Picture(f"why-acting-{k + 1}", title, caption, f"{title}. {caption}", **files)
