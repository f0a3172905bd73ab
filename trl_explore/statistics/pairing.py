"""Trials in several jobs: pairs, pooling, and shared trials.

(``seed``, trial index) determines the random streams of a trial. Two strategies on the same
(seed, trial) form a pair. The same strategy on the same (seed, trial) is the same trial in any
experiment, and counts once.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.statistics.outcomes import PER_TRIAL, Outcomes

# The groups of a configuration that define an agent. The machine, the collector, the number of
# trials and the stopping rule do not.
AGENT_GROUPS = (
    "env", "policy", "loss", "correction", "baseline", "optimizer", "episodes_per_update",
    "intrinsic_reward",
)  # fmt: skip
# Keys of an environment that do not define the agent: its default stopping rule, and the number
# of processes.
NO_AGENT = (
    "score_threshold", "score_window", "max_iterations", "evaluate_confirm", "workers",
)  # fmt: skip


@dataclass(frozen=True)
class SharedTrials:
    """Two jobs, identified by (experiment, name), that contain ``count`` identical trials."""

    first: tuple[str, str]
    second: tuple[str, str]
    count: int


def configuration_key(outcomes: Outcomes) -> str:
    """Canonical text of what defines an agent: strategy, parameters, and ``AGENT_GROUPS``.

    Equal for jobs with the same agents; 1 and 1.0 are equal. Caps and thresholds are not part of
    it: a trial that is stopped later is still the same trial.
    """
    groups = {key: outcomes.config[key] for key in AGENT_GROUPS if outcomes.config.get(key)}
    if isinstance(env := groups.get("env"), Mapping):
        groups["env"] = {key: value for key, value in env.items() if key not in NO_AGENT}
    return canonical([outcomes.strategy, outcomes.parameters, groups])


def canonical(value: Any) -> str:
    """Canonical text of nested values, in which 1 and 1.0 are equal."""
    return json.dumps(json.loads(json.dumps(value, default=str), parse_int=float), sort_keys=True)


def trial_keys(outcomes: Outcomes) -> list[tuple[int, int]]:
    """(seed, trial) of every trial, in order; ValueError if one occurs twice."""
    keys = list(zip(outcomes.seed.tolist(), outcomes.trial.tolist(), strict=True))
    if len(set(keys)) < len(keys):
        twice = next(key for i, key in enumerate(keys) if key in keys[:i])
        raise ValueError(f"{outcomes.name}: seed {twice[0]}, trial {twice[1]} occurs twice")
    return keys


def pair_indices(a: Outcomes, b: Outcomes) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Positions in ``a`` and in ``b`` of the common trials (seed, trial), each [n_pairs]."""
    return common(trial_keys(a), trial_keys(b))


def common(
    a: Sequence[tuple[int, int]], b: Sequence[tuple[int, int]]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Positions in ``a`` and in ``b`` of the common keys, in the order of ``a``.

    >>> [index.tolist() for index in common([(0, 7), (0, 8)], [(0, 9), (0, 8)])]
    [[1], [1]]
    """
    where_b = {key: j for j, key in enumerate(b)}
    pairs = [(i, where_b[key]) for i, key in enumerate(a) if key in where_b]
    index = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    return index[:, 0], index[:, 1]


def shared_trials(jobs: Sequence[Outcomes]) -> list[SharedTrials]:
    """All pairs of jobs that contain the same trials of the same configuration.

    Such jobs (for example ε = 0.3 in the thesis's experiment and in the ε grid, with one seed) are
    not independent: never pool, compare or count them as if they were.
    """
    found = []
    keys = [configuration_key(job) for job in jobs]
    for (a, key), (b, other) in combinations(zip(jobs, keys, strict=True), 2):
        count = len(pair_indices(a, b)[0]) if key == other else 0
        if count:
            found.append(SharedTrials((a.experiment, a.name), (b.experiment, b.name), count))
    return found


def refuse_shared(jobs: Sequence[Outcomes]) -> None:
    """Raise ValueError if :func:`shared_trials` finds any."""
    for shared in shared_trials(jobs):
        a, b = "/".join(shared.first), "/".join(shared.second)
        raise ValueError(
            f"{a} and {b} share {shared.count} trials (same configuration, seed and trial index):"
            " they count once; deduplicate() keeps the first of each"
        )


def deduplicate(jobs: Sequence[Outcomes]) -> list[Outcomes]:
    """Drop trials that an earlier job of the same configuration contains.

    Jobs without remaining trials are dropped; the order is kept.
    """
    seen: set[tuple[str, int, int]] = set()
    kept = []
    for job in jobs:
        key = configuration_key(job)
        keys = [(key, *trial) for trial in trial_keys(job)]
        new = np.array([k not in seen for k in keys], dtype=bool)
        seen.update(keys)
        if new.any():
            kept.append(job if new.all() else select(job, new))
    return kept


def select(outcomes: Outcomes, index: NDArray[Any]) -> Outcomes:
    """Keep the trials at ``index``, a boolean mask [n_trials] or positions."""
    columns = {name: getattr(outcomes, name) for name in PER_TRIAL}
    return replace(outcomes, **{name: x if x is None else x[index] for name, x in columns.items()})


def pool(jobs: Sequence[Outcomes]) -> Outcomes:
    """Pool the jobs of one configuration (different seeds or ranges of trials).

    Name and experiment are those of the first job.

    Raises:
        ValueError: no job; jobs of different configurations or stopping rules; shared trials.
    """
    if not jobs:
        raise ValueError("0 jobs: at least one is needed to pool")
    first = jobs[0]
    for job in jobs[1:]:
        if configuration_key(job) != configuration_key(first):
            raise ValueError(f"{first.name} and {job.name} are different configurations")
        check_comparable(first, job)
    refuse_shared(jobs)
    if len(jobs) == 1:
        return first
    columns = {name: [getattr(job, name) for job in jobs] for name in PER_TRIAL}
    return replace(
        first,
        **{
            name: None if any(x is None for x in parts) else np.concatenate(parts)
            for name, parts in columns.items()
        },
    )


def check_comparable(a: Outcomes, b: Outcomes) -> None:
    """Raise ValueError unless both have the same stopping rule.

    The rule is cap, threshold and window, and which scores (training or evaluation) it uses.
    """
    for word, x, y in (
        ("cap", a.cap, b.cap),
        ("threshold", a.threshold, b.threshold),
        ("window", a.window, b.window),
        ("stopping scores", a.judged_by, b.judged_by),
    ):
        if x != y:
            raise ValueError(
                f"{a.name} has {word} {_text(x)}, {b.name} has {_text(y)}: only configurations"
                f" with the same {word} can be compared"
            )


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"
