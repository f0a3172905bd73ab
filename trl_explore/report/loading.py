"""Read finished jobs from folders, and list what is missing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from trl_explore import jobs as results
from trl_explore.jobs.columns import ResultsError
from trl_explore.statistics.outcomes import Outcomes, convergence_times
from trl_explore.statistics.pairing import trial_keys

Say = Callable[[str], None]
"""Told what is being done, one line per stage."""


def silent(stage: str) -> None:
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
        say(f"reading {number} jobs")
    gaps = [Gap(_short(job), UNFINISHED) for job in sorted(found) if not found[job]]
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
    return Gap(_short(folder), str(error).replace(f"{folder.parent.parent}/", ""))


def _of_job(error: Exception, folder: Path) -> ResultsError:
    if isinstance(error, ResultsError):
        return error
    text = f"{folder}: not readable as a job ({type(error).__name__}: {error})"
    return ResultsError(" ".join(text.split()))


def _short(folder: Path) -> str:
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
        lines = (folder / ".hydra" / "overrides.yaml").read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return ()
    items = [line[2:].strip() for line in lines if line.startswith("- ")]
    return tuple(
        i[1:-1].replace("''", "'") if len(i) > 1 and i[0] == i[-1] == "'" else i for i in items
    )


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
