"""Read finished jobs from folders; what is missing, and which jobs are pilots or repeats."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from numpy.typing import NDArray

from trl_explore import jobs as results
from trl_explore.jobs.files import ResultsError
from trl_explore.jobs.sweep_files import LOOKS, VERDICTS
from trl_explore.names import strategy_label, symbol
from trl_explore.report.factors import value_words
from trl_explore.report.table_formats import listed, some
from trl_explore.statistics.outcomes import Outcomes, convergence_times
from trl_explore.statistics.pairing import configuration_key, deduplicate, trial_keys

Say = Callable[[float, str], None]
"""Called with the share that is done, in [0, 1], and the name of the next stage."""


def silent(done: float, stage: str) -> None:
    """Say nothing."""


UNFINISHED = "not finished: still running, or interrupted"


@dataclass(frozen=True, eq=False)
class Timing:
    """Seconds of single trials [n] and their trial indices [n]."""

    trial: NDArray[np.int64]
    seconds: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Job:
    """A finished job and its folder; ``timing`` if its trials were timed one at a time."""

    folder: Path
    outcomes: Outcomes
    command: tuple[str, ...] = ()
    timing: Timing | None = None


@dataclass(frozen=True)
class Gap:
    """Something that is missing from the report, and why."""

    what: str
    why: str


@dataclass(frozen=True)
class Loaded:
    """The jobs in a set of folders, and what is missing."""

    jobs: list[Job]
    gaps: list[Gap]


def load(folders: Sequence[Path], say: Say = silent) -> Loaded:
    """Read every finished job at or below the folders; unreadable jobs become gaps.

    Raises:
        ResultsError: no job can be read; the message is one line.
    """
    for folder in folders:
        if not folder.is_dir():
            raise ResultsError(f"{folder}: no such folder")
    found = {job.resolve(): done for f in folders for job, done in results.find_folders(f)}
    if (number := sum(found.values())) > 1:
        say(0.0, f"reading {number} jobs")
    gaps = [Gap(_place(job), UNFINISHED) for job in sorted(found) if not found[job]]
    errors: list[Exception] = []
    jobs = []
    timings: dict[Path, pd.DataFrame | None] = {}
    for folder in (job for job, done in found.items() if done):
        try:
            outcomes = _checked(results.read_job(folder), folder)
            flaws = [ResultsError(flaw) for flaw in results.flaws(folder, up_to=results.SMALL)]
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            errors.append(_of_job(error, folder))
            gaps.append(gap(folder, errors[-1]))
            continue
        gaps += [gap(folder, flaw) for flaw in flaws]
        if folder.parent not in timings:
            timings[folder.parent] = _timings(folder.parent, gaps)
        timing = _timing_of(timings[folder.parent], outcomes)
        jobs.append(Job(folder, outcomes, _command(folder), timing))
    if not jobs:
        names = ", ".join(str(folder) for folder in folders)
        reason = gaps[0].why if gaps else "no finished job (run.json) at or below it"
        text = str(errors[0]) if errors else f"{names}: {reason}"
        more = f" (and {len(gaps) - 1} more)" if len(gaps) > 1 else ""
        raise ResultsError(f"{text}{more}")
    return Loaded(jobs, gaps)


def gap(folder: Path, error: Exception) -> Gap:
    """The gap of a job that raised an error; the message without the path to the sweep."""
    return Gap(_place(folder), str(error).replace(f"{folder.parent.parent}/", ""))


def _of_job(error: Exception, folder: Path) -> ResultsError:
    if isinstance(error, ResultsError):
        return error
    text = f"{folder}: not readable as a job ({type(error).__name__}: {error})"
    return ResultsError(" ".join(text.split()))


def _place(folder: Path) -> str:
    return f"{folder.parent.name}/{folder.name}"


def _checked(outcomes: Outcomes, folder: Path) -> Outcomes:
    """Raise :class:`ResultsError` for outcomes that the analysis cannot use."""
    where = folder / results.TRIALS
    if not len(outcomes):
        raise ResultsError(f"{where}: no trials")
    try:
        convergence_times(outcomes)
        trial_keys(outcomes)
    except ValueError as error:
        raise ResultsError(f"{where}: {error}") from None
    return outcomes


def _command(folder: Path) -> tuple[str, ...]:
    """The overrides of the job as Hydra recorded them; empty if they are missing."""
    try:
        text = (folder / ".hydra" / "overrides.yaml").read_text(encoding="utf-8")
        return tuple(map(str, yaml.safe_load(text) or ()))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, TypeError):
        return ()


def _timings(sweep: Path, gaps: list[Gap]) -> pd.DataFrame | None:
    try:
        return results.read_timings(sweep)
    except ResultsError as error:
        gaps.append(gap(sweep / results.TIMINGS, error))
        return None


def _timing_of(timings: pd.DataFrame | None, outcomes: Outcomes) -> Timing | None:
    if timings is None:
        return None
    mine = (timings["experiment"] == outcomes.experiment) & (timings["job"] == outcomes.name)
    rows = np.flatnonzero(mine & timings["trial"].isin(outcomes.trial.tolist()))
    if not len(rows):
        return None
    trial, seconds = np.asarray(timings["trial"])[rows], np.asarray(timings["seconds"])[rows]
    order = np.argsort(trial)
    return Timing(trial[order].astype(np.int64), seconds[order].astype(np.float64))


StoppingRule = tuple[Any, ...]
"""Experiment, cap, and the rest of the rule."""


def set_aside(by_rule: dict[StoppingRule, list[Job]]) -> dict[StoppingRule, list[str]]:
    """Remove the pilots; a note for the group that is used instead of each."""
    sizes = {rule: _trials_by_key(jobs) for rule, jobs in by_rule.items()}
    notes: dict[StoppingRule, list[str]] = {}
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
        counts = np.unique(np.concatenate([o.seed for o in kept]), return_counts=True)
        seeds = [f"{seed} ({n:,} trials)" for seed, n in zip(*counts, strict=True)]
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
    """What was decided while trials were added, and a warning about all other numbers."""
    sweeps = dict.fromkeys(job.folder.parent for job in jobs)
    found = []
    for sweep in (f for f in sweeps if (f / LOOKS).is_file()):
        try:
            with (sweep / VERDICTS).open(encoding="utf-8", newline="") as file:
                rows = [(r["first"], r["second"], r["greater mean"]) for r in csv.DictReader(file)]
        except (OSError, KeyError, csv.Error):
            rows = []
        said = [
            f"{more} (against {b if more == a else a})" for a, b, more in rows if more in (a, b)
        ]
        left = sum(more == "open" for *_, more in rows)
        found.append(
            "Trials were added until the comparisons were decided (until=settled). With the error"
            f" held over all looks, the greater mean is that of {some(said) if said else 'none'};"
            f" {left} of {len(rows)} pairs are open (all in {sweep.name}/{VERDICTS}). The p-values"
            " and intervals of this page do not allow for the looks, and are too sure."
        )
    return found
