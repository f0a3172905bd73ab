"""All results of a report, computed once: summaries, comparisons, verdicts, the answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from trl_explore import thesis
from trl_explore.names import experiment, experiment_rank
from trl_explore.report import layouts, sentences
from trl_explore.report.crossings import Cell
from trl_explore.report.curves import Traces, read_traces
from trl_explore.report.decomposition import Decomposition, decompose
from trl_explore.report.groups import Group, group_jobs
from trl_explore.report.loading import Gap, Loaded, Say, silent
from trl_explore.report.questions import Question
from trl_explore.report.selecting import asked, own_claims, without
from trl_explore.report.study_file import StudyFile
from trl_explore.report.table_formats import uncapital
from trl_explore.report.why import headline
from trl_explore.statistics.comparisons import SCORE, Comparison, compare_pairs
from trl_explore.statistics.estimates import LEVEL
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import SharedTrials, shared_trials
from trl_explore.statistics.summary import Summary, summarise

MOST_ANSWERS = 8
"""The most questions, in addition to the main one, in the answer."""
MOST_PAIRS = 400
"""The most pairs of a question that is asked in addition to that of a layout."""


@dataclass(frozen=True, eq=False)
class Answered:
    """A question with its comparisons, corrected together, and its answer."""

    question: Question
    comparisons: list[Comparison]
    sentences: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class GroupEvidence:
    """The results for one group; ``sentences`` state the answers, the largest effect first.

    If nothing can be compared, ``comparisons`` is empty and ``incomparable`` gives the reason. For
    a crossed group or a plane, it holds the planned pairs only. ``scores`` compares the final
    scores of the same pairs. ``answered`` has one entry per question of several. ``learned`` has
    the same results by what was learned; None if that is unknown.
    """

    group: Group
    summaries: list[Summary]
    comparisons: list[Comparison]
    incomparable: str
    sentences: tuple[str, ...]
    traces: Traces
    scores: list[Comparison]
    answered: Sequence[Answered] = ()
    learned: GroupEvidence | None = None
    level: float = LEVEL

    @property
    def strict_level(self) -> float:
        """Level of one test after Bonferroni's correction for all comparisons."""
        return 1.0 - (1.0 - self.level) / max(1, len(self.comparisons))

    @property
    def why(self) -> bool:
        """Whether the group belongs to the section on the bias."""
        return experiment(self.group.experiment).why and self.group.crossed is not None

    @property
    def single(self) -> bool:
        """Whether there is nothing to compare with."""
        return len(self.group.configurations) < 2

    @property
    def size(self) -> float:
        """The largest significant difference, as a share of the cap."""
        found = [*self.comparisons, *(c for a in self.answered for c in a.comparisons)]
        return effect(found)

    def summary(self, name: str) -> Summary:
        """The statistics of a configuration."""
        return next(s for s in self.summaries if s.name == name)


@dataclass(frozen=True, eq=False)
class Evidence:
    """All results of the report; the main group comes first, ``answer`` is a few sentences.

    ``checked`` is empty if none of the statements applies. ``decompositions``, ``reexamined`` and
    ``causes`` are empty if no corrections were run.
    """

    study: StudyFile
    groups: list[GroupEvidence]
    checked: list[thesis.Checked]
    reexamined: list[thesis.Reexamined]
    causes: list[thesis.Checked]
    decompositions: list[Decomposition]
    answer: tuple[str, ...]
    shared: list[SharedTrials]
    gaps: list[Gap]
    outcomes: list[Outcomes]

    @property
    def timed(self) -> int:
        """Number of trials that were timed alone."""
        return sum(len(e.group.timed(c)[1]) for e in self.groups for c in e.group.configurations)


def gather(loaded: Loaded, study: StudyFile | None = None, say: Say = silent) -> Evidence:
    """Compute everything that a study asks; without one, what the jobs allow."""
    study = study or StudyFile()
    jobs = without(loaded.jobs, study)
    gaps = list(loaded.gaps)
    groups = asked(group_jobs(jobs, together=bool(study.compare)), study)
    parts = []
    for k, group in enumerate(groups, start=1):
        stage = f"{k} of {len(groups)}: {group.title}, {len(group.configurations)} configurations"
        say(0.1 + 0.3 * (k - 1) / len(groups), stage)
        parts.append(_group_evidence(group, gaps, study))
    parts.sort(key=lambda p: (p.single, experiment_rank(p.group.experiment), -p.size,
                              not any(s.converged for s in p.summaries)))  # fmt: skip
    outcomes = [job.outcomes for job in jobs]
    timed = {f"{j.outcomes.experiment}/{j.outcomes.name}": j.timing for j in reversed(jobs)}
    data = thesis.Study(
        outcomes,
        seconds={key: t.seconds for key, t in timed.items() if t is not None},
        timed_trials={key: t.trial for key, t in timed.items() if t is not None},
        level=study.level,
    )
    say(0.4, "statements")
    claims = thesis.CLAIMS
    if isinstance(study.claims, tuple):
        claims = own_claims(study.claims, study.path.name if study.path else "study")
    checked = thesis.check_claims(data, claims)
    if study.claims == "thesis" and all(c.finding.verdict == thesis.NOT_MEASURED for c in checked):
        checked = []  # none of the thesis's statements applies
    why = any(experiment(o.experiment).why for o in outcomes)
    runs = []
    for p in parts:
        learned = {c.name: c for c in p.group.learned}
        runs += [Cell(p.group.environment, c, learned.get(c.name), p.traces.heights.get(c.name))
                 for c in p.group.configurations]  # fmt: skip
    decompositions = decompose(runs, study.level)
    return Evidence(
        study=study,
        groups=parts,
        checked=checked,
        reexamined=thesis.reexamine(data) if why else [],
        causes=thesis.check_claims(data, thesis.CAUSES) if why else [],
        decompositions=decompositions,
        answer=(
            *headline(decompositions),
            *_answers(parts),
            *sentences.verdicts(checked, "thesis" if study.claims in (None, "thesis") else "study"),
        ),
        shared=shared_trials(outcomes),
        gaps=gaps,
        outcomes=outcomes,
    )


def effect(comparisons: Sequence[Comparison]) -> float:
    """The largest significant difference of any pair, as a share of the cap; 0 if there is none."""
    real = (abs(c.difference.value) / c.cap for c in comparisons if c.winner is not None)
    return max(real, default=0.0)


def _answers(parts: Sequence[GroupEvidence]) -> tuple[str, ...]:
    """The sentences of the main group, one of every other, and the jobs without a partner."""
    main, *others = parts
    compared = [p for p in others if not p.single]
    said = [f"{p.group.title}: {p.sentences[0]}" for p in compared if p.sentences]
    more = len(said) - MOST_ANSWERS
    where = f"{main.group.title}: " if compared else ""
    return (
        *(f"{where}{s}" if k == 0 else s for k, s in enumerate(main.sentences)),
        *said[:MOST_ANSWERS],
        *([f"The sections below answer {more} more questions."] if more > 0 else []),
        *sentences.alone([p.group for p in others if p.single]),
    )


def _group_evidence(group: Group, gaps: list[Gap], study: StudyFile) -> GroupEvidence:
    traces = Traces() if group.plane is not None else read_traces(group)
    gaps.extend(found for found in traces.gaps if found not in gaps)
    found = _measured(group, traces, study)
    if not group.learned:
        return found
    learned = replace(group, configurations=list(group.learned), learned=())
    by_learning = _measured(learned, traces, study)
    said = [
        s if s.startswith("The learned") else f"Judged by what was learned, {uncapital(s)}"
        for s in by_learning.sentences
        if s not in found.sentences and "confounded" not in s
    ]
    return replace(found, learned=by_learning, sentences=(*found.sentences, *said))


def _measured(group: Group, traces: Traces, study: StudyFile) -> GroupEvidence:
    """The results of a group by the measure of its configurations."""
    configurations, level = group.configurations, study.level
    learned = group.did == "learned"
    timed = learned or "passed" in study.measures
    pairs = group.pairs()
    comparisons: list[Comparison] = []
    scores: list[Comparison] = []
    answered: list[Answered] = []
    incomparable = "" if len(configurations) > 1 else "there is only one configuration"
    try:
        comparisons = compare_pairs(pairs, level=level)
        if learned or "score" in study.measures:
            scores = compare_pairs(pairs, SCORE, level=level)
        answered = _answered(group, comparisons, level)
    except ValueError as error:
        incomparable = str(error)
    if not pairs and len(configurations) > 1 and group.confounds:
        incomparable = "no two configurations differ in one factor only"
    return GroupEvidence(
        group=group,
        summaries=[summarise(c, level=level) for c in configurations],
        comparisons=comparisons,
        incomparable=incomparable,
        sentences=(
            *(_sentences(group, comparisons, level) if timed and not answered else ()),
            *(s for a in answered if timed for s in a.sentences),
            *(sentences.confounded_sentence(c, group) for c in group.confounds),
            *(
                ()
                if group.plane is not None or group.sized
                else sentences.score_sentence(comparisons if timed else None, scores, group)
            ),
            *sentences.warning(group, comparisons, level),
        ),
        traces=traces,
        scores=scores,
        answered=answered,
        level=level,
    )


def _answered(group: Group, comparisons: list[Comparison], level: float) -> list[Answered]:
    """The answers of a group with several questions, the largest effect first."""
    if group.plane is not None or group.sized or (group.free and not group.chosen):
        return []
    by_name = {c.name: c for c in group.configurations}
    found = []
    for question in group.questions:
        layout = group.crossed
        if layout is not None and not group.chosen and question.of == layout.of:
            cells = {n: (layout.rows[r], layout.options[o]) for (r, o), n in layout.cells.items()}
            found.append(
                Answered(question, comparisons, layouts.option_sentences(comparisons, cells))
            )
        elif len(question.pairs) <= MOST_PAIRS:
            table = compare_pairs([(by_name[a], by_name[b]) for a, b in question.pairs],
                                  level=level)  # fmt: skip
            said = (sentences.question_sentence(question, table, by_name),)
            found.append(Answered(question, table, said))
    return sorted(found, key=lambda a: -effect(a.comparisons))


def _sentences(group: Group, comparisons: Sequence[Comparison], level: float) -> tuple[str, ...]:
    if group.sized:
        return (layouts.size_sentence(group.configurations),)
    if group.plane is not None:
        return layouts.plane_sentences(group.configurations, comparisons, group.labels, level)
    if group.confounds:
        return ()
    return sentences.answer(group.configurations, comparisons, labels=group.labels, level=level)
