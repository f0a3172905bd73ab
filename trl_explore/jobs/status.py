"""The status of a sweep: which jobs are done, running, failed, cut off or left.

A folder with ten thousand jobs is read in about a second: one small file for each finished job (two
if it is shown), and the header of a checkpoint for each unfinished one. Neither torch nor pandas is
needed.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trl_explore.jobs.checkpoint import FOLDER as CHECKPOINT
from trl_explore.jobs.checkpoint import SLOTS
from trl_explore.jobs.columns import (
    EPISODES,
    LEARN_COLUMNS,
    PASS_COLUMNS,
    TRIALS,
    read_table,
)
from trl_explore.jobs.console import printable, text_table
from trl_explore.jobs.files import RUN, ResultsError, read_file
from trl_explore.jobs.lock import NAME as LOCK
from trl_explore.jobs.lock import is_locked
from trl_explore.jobs.sweeps import MULTIRUN, SWEEP, read_asked, read_failures

DONE, RUNNING, FAILURE, CUT, LEFT = "done", "running", "failed", "cut off", "left"
STATES = (DONE, RUNNING, FAILURE, CUT, LEFT)
MARKS = {RUN, TRIALS, EPISODES, ".hydra", CHECKPOINT, LOCK}
"""A folder that holds one of these is the folder of a job."""
HEAD = 2**24
"""Maximum size of the header of a checkpoint in bytes; a larger one is not a checkpoint."""
SHOWN = 40
"""In a sweep with more jobs than this, finished jobs are not shown."""


@dataclass(frozen=True)
class JobStatus:
    """A job: its state, the number of iterations saved so far, and their seconds.

    ``cap`` is the maximum number of iterations; ``reason`` says why the job failed. Unknown values
    are None.
    """

    name: str
    state: str
    iterations: int | None = None
    cap: int | None = None
    seconds: float | None = None
    reason: str = ""


@dataclass(frozen=True)
class SweepStatus:
    """The jobs in a folder, sorted by name."""

    folder: Path
    jobs: list[JobStatus]

    def counts(self) -> dict[str, int]:
        """How many jobs are in each state."""
        found = Counter(job.state for job in self.jobs)
        return {state: found[state] for state in STATES}


def survey(folders: Iterable[Path]) -> list[SweepStatus]:
    """The sweeps at or below the folders; the folder of a job gives a sweep with only this job.

    Raises:
        ResultsError: if a folder does not exist, or holds no job.
    """
    found: dict[Path, SweepStatus] = {}
    for folder in folders:
        if not folder.is_dir():
            raise ResultsError(f"{folder}: no such folder")
        here = list(_sweeps(folder.resolve()))
        if not here:
            raise ResultsError(f"{folder}: no job at or below it")
        for sweep in here:
            known = found.get(sweep.folder)
            jobs = {job.name: job for s in (known, sweep) if s for job in s.jobs}
            found[sweep.folder] = SweepStatus(sweep.folder, [jobs[name] for name in sorted(jobs)])
    return list(found.values())


def _sweeps(folder: Path) -> Iterator[SweepStatus]:
    job = _job(folder)
    if job is not None:
        failures = read_failures(folder.parent)
        yield SweepStatus(folder.parent, [_with_failure(job, failures)])
        return
    jobs: dict[str, JobStatus] = {}
    below = []
    for name in _subfolders(folder):
        job = _job(folder / name)
        if job is None:
            below.append(name)
        else:
            jobs[name] = job
    failures = read_failures(folder)
    for name in [*read_asked(folder), *failures]:
        jobs.setdefault(name, JobStatus(name, LEFT))
    if jobs:
        yield SweepStatus(folder, [_with_failure(jobs[name], failures) for name in sorted(jobs)])
    for name in below:
        yield from _sweeps(folder / name)


def _subfolders(folder: Path) -> list[str]:
    """The folders in a folder, without hidden folders and links, which may lead anywhere."""
    try:
        with os.scandir(folder) as entries:
            return sorted(
                entry.name
                for entry in entries
                if not entry.name.startswith(".") and entry.is_dir(follow_symlinks=False)
            )
    except OSError:
        return []


def _with_failure(job: JobStatus, failures: dict[str, str]) -> JobStatus:
    if job.name not in failures or job.state in (DONE, RUNNING):
        return job
    return JobStatus(job.name, FAILURE, job.iterations, job.cap, job.seconds, failures[job.name])


def _job(folder: Path) -> JobStatus | None:
    """The state of a job; None if the folder is not that of a job."""
    run = _json(folder / RUN)
    if run is not None:
        return _described(folder.name, DONE, run)
    try:
        with os.scandir(folder) as entries:
            names = {entry.name for entry in entries}
    except OSError:
        return None
    if not names & MARKS or names & {SWEEP, MULTIRUN}:
        return None
    state = RUNNING if is_locked(folder) else CUT
    return _described(folder.name, state, _progress(folder) if CHECKPOINT in names else {})


def _json(path: Path) -> dict[str, Any] | None:
    """The contents of a file; None if there is none, empty if it is not readable."""
    if not path.is_file():
        return None
    try:
        content = json.loads(read_file(path))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _progress(folder: Path) -> dict[str, Any]:
    """The header of the newest checkpoint of any shard."""
    slots = [path for name in SLOTS for path in (folder / CHECKPOINT).glob(f"*/{name}")]
    headers = [header for path in slots if (header := _header(path))]
    return max(headers, key=_newness, default={})


def _newness(header: dict[str, Any]) -> tuple[float, int]:
    seconds = header.get("seconds")
    known = isinstance(seconds, int | float)
    return float(seconds) if known else -1.0, _integer(header.get("iteration")) or -1


def _header(path: Path) -> dict[str, Any]:
    """The header of a checkpoint, from the first bytes of the file."""
    try:
        if not path.is_file():
            return {}
        with path.open("rb") as file:
            size = int.from_bytes(file.read(8), "little")
            metadata = json.loads(file.read(size))["__metadata__"] if size <= HEAD else {}
        header = json.loads(metadata["header"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}
    return header if isinstance(header, dict) else {}


def _described(name: str, state: str, record: dict[str, Any]) -> JobStatus:
    config = record.get("config")
    seconds = record.get("seconds")
    if not isinstance(seconds, int | float) or not 0 <= seconds < float("inf"):
        seconds = None
    return JobStatus(
        name,
        state,
        _integer(record.get("iterations", record.get("iteration"))),
        _integer(config.get("max_iterations")) if isinstance(config, dict) else None,
        seconds,
    )


def _integer(value: Any) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def report(sweep: SweepStatus, *, everything: bool = False) -> str:
    """One line for the sweep, and one line for each job.

    Args:
        sweep: its status.
        everything: whether to show the finished jobs of a sweep with many jobs, too.
    """
    counts = sweep.counts()
    left = counts[CUT] + counts[LEFT]
    cut = f" ({counts[CUT]} of them cut off)" if counts[CUT] else ""
    lines = [
        f"{printable(str(sweep.folder))}: {counts[DONE]} of {len(sweep.jobs)} done, "
        f"{counts[RUNNING]} running, {counts[FAILURE]} failed, {left} left{cut}"
    ]
    shown = [
        job for job in sweep.jobs if everything or len(sweep.jobs) <= SHOWN or job.state != DONE
    ]
    if shown:
        header = ("job", "state", "iterations", "passed", "learned", "seconds", "")
        rows = [header, *(_row(sweep.folder, job) for job in shown)]
        lines += [f"  {line}" for line in text_table(rows, left={0, 1, 6})]
    return "\n".join(lines)


def _row(sweep: Path, job: JobStatus) -> tuple[str, ...]:
    iterations = "–" if job.iterations is None else f"{job.iterations:,}"
    if job.state != DONE and job.iterations is not None and job.cap is not None:
        iterations += f" of {job.cap:,}"
    seconds = "–" if job.seconds is None else f"{job.seconds:,.1f}"
    measures = _measures(sweep / job.name) if job.state == DONE else ("–", "–")
    return printable(job.name), job.state, iterations, *measures, seconds, printable(job.reason)


def _measures(job: Path) -> tuple[str, str]:
    """How many trials of a finished job have passed and learned, out of how many."""
    try:
        table = read_table(job / TRIALS, {}, PASS_COLUMNS, LEARN_COLUMNS)
    except ResultsError:
        return "–", "–"
    passed, learned = (
        f"{int(table[name].sum())} of {len(table[name])}" if name in table else "–"
        for name in ("passed", "learned")
    )
    return passed, learned
