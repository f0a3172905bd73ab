"""Everything a report says, computed once: summaries, comparisons, verdicts, the answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trl_explore.analysis.answer import answer
from trl_explore.analysis.bootstrap import RESAMPLES, streams
from trl_explore.analysis.claims import Checked, Study, check_claims
from trl_explore.analysis.comparisons import Comparison, compare_all
from trl_explore.analysis.estimates import LEVEL
from trl_explore.analysis.outcomes import Outcomes
from trl_explore.analysis.pairing import SharedTrials, shared_trials
from trl_explore.analysis.summary import Summary, summarise_all
from trl_explore.report.curves import learning_rows
from trl_explore.report.figures import learning
from trl_explore.report.groups import Group, group_jobs
from trl_explore.report.labels import readable
from trl_explore.report.loading import Gap, Loaded

SEED = 20170101
"""Of every bootstrap and permutation of a report, so that it is the same when made twice."""
FEWER_RESAMPLES, MANY_DRAWS = 1999, 3_000_000_000


@dataclass(frozen=True, eq=False)
class GroupEvidence:
    """What was computed for one group; ``sentences``: who is fastest, which differences are real.

    ``comparisons`` is empty, with the reason in ``incomparable``, where nothing can be compared.
    """

    group: Group
    summaries: list[Summary]
    comparisons: list[Comparison]
    incomparable: str
    sentences: tuple[str, str]
    learning: list[learning.Row]
    level: float
    resamples: int


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the report shows; ``answer`` is three sentences, the main group comes first."""

    groups: list[GroupEvidence]
    checked: list[Checked]
    answer: tuple[str, str, str]
    shared: list[SharedTrials]
    gaps: list[Gap]
    outcomes: list[Outcomes]

    @property
    def timed(self) -> int:
        """How many trials were timed by themselves."""
        timings = [e.group.timing(c.name) for e in self.groups for c in e.group.configurations]
        return sum(len(t.seconds) for t in timings if t is not None)


def gather(loaded: Loaded, *, level: float = LEVEL, resamples: int = RESAMPLES) -> Evidence:
    """Compute everything; each part has a random stream of its own, named after it."""
    groups = group_jobs(loaded.jobs)
    rngs = streams(np.random.default_rng(SEED), ["claims", *(g.id for g in groups)])
    gaps = list(loaded.gaps)
    parts = [_group_evidence(g, rngs[g.id], level, resamples, gaps) for g in groups]
    outcomes = [job.outcomes for job in loaded.jobs]
    timed = {f"{j.outcomes.experiment}/{j.outcomes.name}": j.timing for j in reversed(loaded.jobs)}
    study = Study(
        outcomes,
        seconds={key: t.seconds for key, t in timed.items() if t is not None},
        timed_trials={key: t.trial for key, t in timed.items() if t is not None},
        level=level,
        resamples=resamples,
    )
    checked = check_claims(study, rngs["claims"])
    main = parts[0]
    sentences = answer(
        main.group.configurations, main.comparisons, checked, labels=main.group.labels
    )
    return Evidence(parts, checked, _clean(sentences), shared_trials(outcomes), gaps, outcomes)


def _clean(sentences: Sequence[str]) -> tuple[str, str, str]:
    first, second, third = (readable(s) for s in sentences)
    return first, second, third


def _group_evidence(
    group: Group, rng: np.random.Generator, level: float, resamples: int, gaps: list[Gap]
) -> GroupEvidence:
    configurations = group.configurations
    n, trials = len(configurations), max(len(c) for c in configurations)
    if n * (n - 1) / 2 * trials * resamples > MANY_DRAWS:
        resamples = min(resamples, FEWER_RESAMPLES)
    rngs = streams(rng, ["summaries", "comparisons"])
    comparisons: list[Comparison] = []
    incomparable = "" if n > 1 else "there is only one configuration"
    try:
        comparisons = compare_all(
            configurations, rngs["comparisons"], level=level, resamples=resamples
        )
    except ValueError as error:
        incomparable = str(error)
    rows, missing = learning_rows(group)
    gaps.extend(missing)
    sentences = answer(configurations, comparisons, [], labels=group.labels)[:2]
    return GroupEvidence(
        group=group,
        summaries=summarise_all(
            configurations, rngs["summaries"], level=level, resamples=resamples
        ),
        comparisons=comparisons,
        incomparable=incomparable,
        sentences=(readable(sentences[0]), readable(sentences[1])),
        learning=rows,
        level=level,
        resamples=resamples,
    )
