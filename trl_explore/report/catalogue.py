"""Every figure of a group, drawn, with its title, caption and alternative text."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from trl_explore.report.evidence import GroupEvidence
from trl_explore.report.kinds import KINDS
from trl_explore.report.render import to_png, to_svg
from trl_explore.report.style import visual_language

THESIS_NUMBERS = {
    ("thesis", "score"): "3.1",
    ("thesis", "iterations"): "3.2",
    ("thesis", "seconds"): "3.3",
    ("epsilon_grid", "score"): "2.1",
    ("decay_grid", "iterations"): "2.2",
    ("decay_grid", "score"): "2.3",
    ("decay_grid", "seconds"): "2.4",
    ("decay_grid", "epsilon"): "2.5",
}


@dataclass(frozen=True)
class Drawn:
    """A figure of the report; ``thesis`` is its number in the thesis, if it has one."""

    id: str
    kind: str
    group: str
    title: str
    caption: str
    alt: str
    thesis: str | None
    svg: str
    png: bytes


def draw_all(evidence: GroupEvidence) -> Iterator[Drawn]:
    """Draw every figure of a group, in order."""
    group = evidence.group
    for kind in KINDS:
        if not kind.applies(evidence):
            continue
        with visual_language():
            figure = kind.draw(evidence)
            svg, png = to_svg(figure), to_png(figure)
        caption = kind.caption(evidence)
        thesis = THESIS_NUMBERS.get((group.experiment, kind.name))
        number = f"{thesis}-" if thesis else ""
        yield Drawn(
            id=f"{group.id}-{number.replace('.', '_')}{kind.name}",
            kind=kind.name,
            group=group.id,
            title=kind.title,
            caption=caption,
            alt=f"{kind.title}, {group.title}. {caption}",
            thesis=thesis,
            svg=svg,
            png=png,
        )
