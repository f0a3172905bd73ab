"""Which kinds of figures there are, in which order, and for which groups."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from matplotlib.figure import Figure

from trl_explore.report import captions, drawing, layout_captions, panels
from trl_explore.report.evidence import GroupEvidence

FEW = 16
"""Most configurations of a figure with one row, or panel, for each."""
FEWER = 12
"""Most configurations whose curves share a panel."""


@dataclass(frozen=True)
class Kind:
    """A kind of figure: when there is one, how it is drawn, and what is said about it."""

    name: str
    title: str
    applies: Callable[[GroupEvidence], bool]
    draw: Callable[[GroupEvidence], Figure]
    caption: Callable[[GroupEvidence], str]


def _few(e: GroupEvidence) -> bool:
    return e.group.plane is None and len(e.group.configurations) <= FEW


def _plain(e: GroupEvidence) -> bool:
    """Neither crossed nor a plane: every configuration stands beside every other one."""
    return e.group.crossed is None and e.group.plane is None


def _whole_study(e: GroupEvidence) -> bool:
    return _plain(e) and not e.group.is_grid


def _crossed(e: GroupEvidence) -> bool:
    return e.group.crossed is not None


def _plane(e: GroupEvidence) -> bool:
    return e.group.plane is not None


def _recorded(name: str, e: GroupEvidence) -> bool:
    readable = _crossed(e) or len(e.group.configurations) <= FEWER
    return readable and name in e.traces.diagnostics


def _timed(e: GroupEvidence) -> bool:
    return any(e.group.timing(c.name) is not None for c in e.group.configurations)


def _comparable(e: GroupEvidence) -> bool:
    return len(e.comparisons) > 0 and e.group.plane is None


def _threshold(e: GroupEvidence) -> tuple[float, str]:
    return e.group.threshold, f"passes above {e.group.threshold:g}"


def _cap(e: GroupEvidence) -> tuple[float, str]:
    return e.group.cap, f"cap: {e.group.cap:,} iterations"


def _diagnostic(name: str, e: GroupEvidence) -> Figure:
    return panels.draw_diagnostic(e, name)


DIAGNOSTICS = {
    "kl": "How far μ was from π",
    "effective_sample_size": "What the data are worth to π",
    "ratio_mean": "The mean ratio",
    "exploratory": "How many actions explored",
    "greedy_share": "Lock-in",
    "coverage": "How much was seen",
    "gradient_norm": "How strong the signal was",
}

KINDS: tuple[Kind, ...] = (
    Kind(
        "map-pass",
        "Where trials pass",
        _plane,
        lambda e: panels.draw_map(e, "pass"),
        layout_captions.map_pass,
    ),
    Kind(
        "map-iterations",
        "How many iterations they take",
        _plane,
        lambda e: panels.draw_map(e, "iterations"),
        layout_captions.map_iterations,
    ),
    Kind(
        "effects",
        "What the options do",
        _crossed,
        panels.draw_effects,
        layout_captions.effects,
    ),
    Kind(
        "survival-panels",
        "How many trials are still learning",
        _crossed,
        lambda e: panels.draw_survival_panels(e.group),
        layout_captions.survival,
    ),
    Kind(
        "survival",
        "How many trials are still learning",
        _plain,
        lambda e: drawing.draw_survival(e.group, "iterations"),
        captions.survival,
    ),
    Kind(
        "score",
        "Final score of every trial",
        _few,
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
        _few,
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
        _few,
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
        lambda e: _whole_study(e) and _few(e) and len(e.learning) > 0,
        drawing.draw_learning,
        captions.learning,
    ),
    Kind(
        "learning-panels",
        "Learning curves",
        lambda e: _crossed(e) and len(e.learning) > 0,
        panels.draw_learning_panels,
        layout_captions.learning,
    ),
    Kind(
        "evaluation",
        "The agent without its exploration",
        lambda e: _few(e) and len(e.traces.evaluations) > 0,
        panels.draw_evaluation,
        layout_captions.evaluation,
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
        lambda e: _whole_study(e) and _few(e) and len(drawing.power_pairs(e)) > 0,
        drawing.draw_power,
        captions.power,
    ),
    *(
        Kind(
            name,
            title,
            partial(_recorded, name),
            partial(_diagnostic, name),
            partial(layout_captions.diagnostic, name),
        )
        for name, title in DIAGNOSTICS.items()
    ),
    Kind(
        "entropy",
        "How random the policies are",
        partial(_recorded, "entropy_policy"),
        panels.draw_entropy,
        layout_captions.entropy,
    ),
)
