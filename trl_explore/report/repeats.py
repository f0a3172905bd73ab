"""Pilots and repeats: jobs of a configuration that was also run elsewhere in the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trl_explore.jobs.sweeps import LOOKS
from trl_explore.names import strategy_label, symbol
from trl_explore.report.factors import value_words
from trl_explore.report.loading import Job
from trl_explore.report.tables import listed, some
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import configuration_key, deduplicate

Rule = tuple[Any, ...]
"""Experiment, cap, and the rest of a stopping rule."""


def set_aside(by_rule: dict[Rule, list[Job]]) -> dict[Rule, list[str]]:
    """Remove the pilots; a note for the group that is used instead of each."""
    sizes = {rule: _trials_by_key(jobs) for rule, jobs in by_rule.items()}
    notes: dict[Rule, list[str]] = {}
    for rule, mine in sorted(sizes.items(), key=lambda item: sum(item[1].values())):
        for other, theirs in sizes.items():
            longer = other[1] >= rule[1] and (other[0], *other[2:]) == (rule[0], *rule[2:])
            if other == rule or not longer or other not in by_rule:
                continue
            if all(theirs.get(key, 0) > n for key, n in mine.items()):
                names = some([_short(job.outcomes) for job in by_rule.pop(rule)])
                notes.setdefault(other, []).append(
                    f"A pilot is not used: {names} with {max(mine.values()):,} trials and a cap of"
                    f" {rule[1]:,} iterations. The same configurations were run here with more"
                    f" trials and a cap of {other[1]:,}."
                )
                break
    return notes


def _trials_by_key(jobs: Sequence[Job]) -> dict[str, int]:
    counts: dict[str, int] = {}
    for outcomes in deduplicate([job.outcomes for job in jobs]):
        key = configuration_key(outcomes)
        counts[key] = counts.get(key, 0) + len(outcomes)
    return counts


def repeats(jobs: Sequence[Job]) -> list[str]:
    """What is done with several jobs of one configuration."""
    by_key: dict[str, list[Job]] = {}
    for job in jobs:
        by_key.setdefault(configuration_key(job.outcomes), []).append(job)
    pooled: dict[str, list[str]] = {}
    repeated: dict[str, list[str]] = {}
    for same in by_key.values():
        kept = deduplicate([job.outcomes for job in same])
        counts = [
            pair for o in kept for pair in np.column_stack(np.unique(o.seed, return_counts=True))
        ]
        seeds = sorted({f"{seed} ({n:,} trials)" for seed, n in counts})
        name = _short(same[0].outcomes)
        if len(seeds) > 1:
            pooled.setdefault(listed(seeds), []).append(name)
        if sum(len(j.outcomes) for j in same) > sum(map(len, kept)):
            trials = max(len(j.outcomes) for j in same)
            repeated.setdefault(f"{trials:,}", []).append(name)
    return [
        *(f"Repeats are pooled: seeds {seeds} of {some(n)}." for seeds, n in pooled.items()),
        *(
            f"Several jobs hold the same trials of {some(names)}; each trial counts once."
            for names in repeated.values()
        ),
    ]


def _short(o: Outcomes) -> str:
    own = [f"{symbol(f'strategy.{k}')} = {value_words(v)}" for k, v in o.parameters.items()]
    return ", ".join([strategy_label(o.strategy), *own])


def settled(jobs: Sequence[Job]) -> list[str]:
    """A warning where the number of trials was chosen by looking at the results."""
    if not any((job.folder.parent / LOOKS).is_file() for job in jobs):
        return []
    return [
        "Trials were added until the comparisons were decided (trl-explore settle). The verdicts in"
        " settle.csv allow for that; the p-values and intervals of this page do not, and are too"
        " sure."
    ]
