"""Which figures a report has, in which order, with titles, captions and alternative texts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from matplotlib.figure import Figure

from trl_explore.report import captions, drawing
from trl_explore.report.evidence import GroupEvidence
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


@dataclass(frozen=True)
class Kind:
    """A kind of figure: when there is one, how it is drawn, and what is said about it."""

    name: str
    title: str
    applies: Callable[[GroupEvidence], bool]
    draw: Callable[[GroupEvidence], Figure]
    caption: Callable[[GroupEvidence], str]


def _always(e: GroupEvidence) -> bool:
    return True


def _whole_study(e: GroupEvidence) -> bool:
    return not e.group.is_grid


def _timed(e: GroupEvidence) -> bool:
    return any(e.group.timing(c.name) is not None for c in e.group.configurations)


def _comparable(e: GroupEvidence) -> bool:
    return len(e.comparisons) > 0


def _threshold(e: GroupEvidence) -> tuple[float, str]:
    return e.group.threshold, f"passes above {e.group.threshold:g}"


def _cap(e: GroupEvidence) -> tuple[float, str]:
    return e.group.cap, f"cap: {e.group.cap:,} iterations"


KINDS: tuple[Kind, ...] = (
    Kind(
        "survival",
        "How many trials are still learning",
        _always,
        lambda e: drawing.draw_survival(e.group, "iterations"),
        captions.survival,
    ),
    Kind(
        "score",
        "Final score of every trial",
        _always,
        lambda e: drawing.draw_trials(
            e.group,
            drawing.scores,
            f"mean score of the last {e.group.window} episodes",
            _threshold(e),
            may_be_log=False,
        ),
        captions.score,
    ),
    Kind(
        "iterations",
        "Iterations of every trial",
        _always,
        lambda e: drawing.draw_trials(
            e.group, drawing.iterations, "iterations to convergence", _cap(e)
        ),
        captions.iterations,
    ),
    Kind(
        "seconds",
        "Seconds of single trials",
        _timed,
        lambda e: drawing.draw_trials(
            e.group, drawing.seconds(e.group), "seconds of a trial run by itself", None
        ),
        captions.seconds,
    ),
    Kind(
        "frames",
        "Frames of every trial",
        _always,
        lambda e: drawing.draw_trials(
            e.group, drawing.frames, "frames (environment steps) until the trial stopped", None
        ),
        captions.frames,
    ),
    Kind(
        "epsilon",
        "ε under the decay rates",
        lambda e: e.group.experiment == "decay_grid" and len(drawing.decay_rates(e.group)) > 0,
        lambda e: drawing.draw_epsilon(e.group),
        captions.epsilon,
    ),
    Kind(
        "learning",
        "Learning curves",
        lambda e: _whole_study(e) and len(e.learning) > 0,
        drawing.draw_learning,
        captions.learning,
    ),
    Kind(
        "survival-frames",
        "How many trials are still learning, in frames",
        _whole_study,
        lambda e: drawing.draw_survival(e.group, "frames"),
        captions.survival_frames,
    ),
    Kind("forest", "Every pair compared", _comparable, drawing.draw_forest, captions.forest),
    Kind(
        "power",
        "What this number of trials can show",
        lambda e: _whole_study(e) and len(drawing.power_pairs(e)) > 0,
        drawing.draw_power,
        captions.power,
    ),
)


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
