"""All results of a report, computed once: summaries, comparisons, verdicts, the answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from trl_explore.names import experiment
from trl_explore.report.curves import Traces, read_traces
from trl_explore.report.decomposition import Decomposition, decompose, runs_of
from trl_explore.report.groups import Group, group_jobs
from trl_explore.report.layouts import pairs_by_size, size_sentence
from trl_explore.report.loading import Gap, Loaded
from trl_explore.report.sentences import (
    answer,
    option_sentences,
    plane_sentences,
    score_sentence,
    verdicts,
)
from trl_explore.report.why import headline
from trl_explore.statistics.comparisons import SCORE, Comparison, compare_pairs
from trl_explore.statistics.estimates import LEVEL
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import SharedTrials, shared_trials
from trl_explore.statistics.power import fewest_pairs
from trl_explore.statistics.summary import Summary, summarise
from trl_explore.thesis import Checked, Study, check_claims, why


@dataclass(frozen=True, eq=False)
class GroupEvidence:
    """The results for one group; ``sentences`` state the fastest and the significant differences.

    If nothing can be compared, ``comparisons`` is empty and ``incomparable`` gives the reason. For
    a crossed group or a plane, it holds the planned pairs only. ``scores`` compares the final
    scores of the same pairs. ``learned`` has the same results by what was learned; None if that is
    unknown.
    """

    group: Group
    summaries: list[Summary]
    comparisons: list[Comparison]
    incomparable: str
    sentences: tuple[str, ...]
    traces: Traces
    scores: list[Comparison]
    learned: GroupEvidence | None = None

    @property
    def strict_level(self) -> float:
        """Level of one test after Bonferroni's correction for all comparisons."""
        return 1.0 - (1.0 - LEVEL) / max(1, len(self.comparisons))

    @property
    def why(self) -> bool:
        """Whether the group belongs to the section on the bias."""
        return experiment(self.group.experiment).why and self.group.crossed is not None

    def summary(self, name: str) -> Summary:
        """The statistics of a configuration."""
        return next(s for s in self.summaries if s.name == name)


@dataclass(frozen=True, eq=False)
class Evidence:
    """All results of the report; the main group comes first, ``answer`` is a few sentences.

    ``decompositions``, ``reexamined`` and ``causes`` are empty if no corrections were run.
    """

    groups: list[GroupEvidence]
    checked: list[Checked]
    reexamined: list[why.Reexamined]
    causes: list[Checked]
    decompositions: list[Decomposition]
    answer: tuple[str, ...]
    shared: list[SharedTrials]
    gaps: list[Gap]
    outcomes: list[Outcomes]

    @property
    def timed(self) -> int:
        """Number of trials that were timed alone."""
        return sum(len(e.group.timed(c)[1]) for e in self.groups for c in e.group.configurations)


def gather(loaded: Loaded) -> Evidence:
    """Compute everything."""
    groups = group_jobs(loaded.jobs)
    gaps = list(loaded.gaps)
    parts = [_group_evidence(g, gaps) for g in groups]
    outcomes = [job.outcomes for job in loaded.jobs]
    timed = {f"{j.outcomes.experiment}/{j.outcomes.name}": j.timing for j in reversed(loaded.jobs)}
    study = Study(
        outcomes,
        seconds={key: t.seconds for key, t in timed.items() if t is not None},
        timed_trials={key: t.trial for key, t in timed.items() if t is not None},
    )
    checked = check_claims(study)
    reexamined, causes = _why(study)
    runs = [run for part in parts for run in runs_of(part.group, part.traces.heights)]
    decompositions = decompose(runs)
    return Evidence(
        groups=parts,
        checked=checked,
        reexamined=reexamined,
        causes=causes,
        decompositions=decompositions,
        answer=(*headline(decompositions), *parts[0].sentences, verdicts(checked)),
        shared=shared_trials(outcomes),
        gaps=gaps,
        outcomes=outcomes,
    )


def _why(study: Study) -> tuple[list[why.Reexamined], list[Checked]]:
    if not any(experiment(o.experiment).why for o in study.outcomes):
        return [], []
    return why.reexamine(study), check_claims(study, why.CLAIMS)


def _group_evidence(group: Group, gaps: list[Gap]) -> GroupEvidence:
    traces = Traces() if group.plane is not None else read_traces(group)
    gaps.extend(found for found in traces.gaps if found not in gaps)
    found = _measured(group, traces)
    if not group.learned:
        return found
    learned = replace(group, configurations=list(group.learned), learned=())
    by_learning = _measured(learned, traces)
    said = [
        s if s.startswith("The learned") else f"Judged by what was learned, {s[:1].lower()}{s[1:]}"
        for s in by_learning.sentences
    ]
    return replace(found, learned=by_learning, sentences=(*found.sentences, *said))


def _measured(group: Group, traces: Traces) -> GroupEvidence:
    """The results of a group by the measure of its configurations."""
    configurations = group.configurations
    pairs = _pairs(group)
    comparisons: list[Comparison] = []
    scores: list[Comparison] = []
    incomparable = "" if len(configurations) > 1 else "there is only one configuration"
    try:
        comparisons = compare_pairs(pairs)
        scores = compare_pairs(pairs, SCORE)
    except ValueError as error:
        incomparable = str(error)
    return GroupEvidence(
        group=group,
        summaries=[summarise(c) for c in configurations],
        comparisons=comparisons,
        incomparable=incomparable,
        sentences=(
            *_sentences(group, comparisons),
            *_scores_said(group, comparisons, scores),
            *(_cut_short(group) or _too_few(comparisons)),
        ),
        traces=traces,
        scores=scores,
    )


def _scores_said(
    group: Group, comparisons: Sequence[Comparison], scores: Sequence[Comparison]
) -> tuple[str, ...]:
    if group.plane is not None or group.sized:
        return ()
    what = "learned" if group.configurations[0].measure == "learned" else "final"
    said = score_sentence(comparisons, scores, group.labels, what)
    return (said,) if said else ()


def _pairs(group: Group) -> list[tuple[Outcomes, Outcomes]]:
    """The planned pairs of a group with a layout; without one, all pairs."""
    if group.sized:
        return list(pairs_by_size(group.configurations))
    layout = group.crossed or group.plane
    if layout is None:
        return list(combinations(group.configurations, 2))
    by_name = {c.name: c for c in group.configurations}
    return [(by_name[a], by_name[b]) for a, b in layout.pairs()]


def _too_few(comparisons: Sequence[Comparison]) -> tuple[str, ...]:
    """A warning if there are too few trials for any significant difference; otherwise nothing."""
    paired = [c for c in comparisons if c.design == "paired"]
    if not paired or len(paired) < len(comparisons):
        return ()
    n, tests = max(c.n_a for c in paired), len(paired)
    fewest = fewest_pairs(1.0 - (1.0 - LEVEL) / tests)
    if n >= fewest:
        return ()
    corrected = f", corrected for {tests} comparisons," if tests > 1 else ""
    return (
        f"There may still be large differences: {n} trials are too few for any significant result."
        f" The test{corrected} needs at least {fewest} trials of each configuration, even if the"
        " difference is the same in every trial.",
    )


def _cut_short(group: Group) -> tuple[str, ...]:
    """A warning if the cap ends every trial before its first full window; otherwise nothing."""
    if not all(c.cut_short for c in group.configurations):
        return ()
    return (
        f"No trial could pass: the cap of {group.cap:,} iterations ends it before it has played the"
        f" {group.window:,} episodes that the score is averaged over.",
    )


def _sentences(group: Group, comparisons: Sequence[Comparison]) -> tuple[str, ...]:
    if group.sized:
        return (size_sentence(group.configurations),)
    if group.plane is not None:
        return plane_sentences(group.configurations, comparisons, group.labels)
    if group.crossed is not None and comparisons:
        rows, options = group.crossed.rows, group.crossed.options
        cells = {name: (rows[r], options[o]) for (r, o), name in group.crossed.cells.items()}
        return option_sentences(comparisons, cells)
    return answer(group.configurations, comparisons, labels=group.labels)
