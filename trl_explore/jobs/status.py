"""Which jobs of a sweep are done, running, failed or left, and the table that shows it.

The status of ten thousand jobs is read in about a second: one small file for each finished job (two
if it is shown), and the header of a checkpoint for each unfinished one. Neither torch nor pandas is
needed.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from trl_explore.jobs.checkpoint import FOLDER as CHECKPOINT
from trl_explore.jobs.checkpoint import SLOTS
from trl_explore.jobs.columns import EPISODES, LEARN_COLUMNS, PASS_COLUMNS, TRIALS, read_table
from trl_explore.jobs.console import printable, text_table
from trl_explore.jobs.files import RUN, ResultsError
from trl_explore.jobs.lock import NAME as LOCK
from trl_explore.jobs.lock import is_locked
from trl_explore.jobs.sweep_files import MULTIRUN, SWEEP, read_asked, read_failures, read_json

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
    """A job, with its iterations and seconds so far, the cap, and why it failed; None: unknown."""

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
        ResultsError: if a folder does not exist, cannot be read, or holds no job.
    """
    found: dict[Path, dict[str, JobStatus]] = {}
    for folder in folders:
        if not folder.is_dir():
            raise ResultsError(f"{folder}: no such folder")
        here = list(_sweeps(folder.resolve()))
        if not here:
            raise ResultsError(f"{folder}: no job at or below it")
        for sweep, jobs in here:
            found.setdefault(sweep, {}).update({job.name: job for job in jobs})
    return [
        SweepStatus(sweep, [jobs[name] for name in sorted(jobs)]) for sweep, jobs in found.items()
    ]


def _sweeps(folder: Path) -> Iterator[tuple[Path, list[JobStatus]]]:
    """The folder of each sweep at or below a folder, and its jobs."""
    if (job := _job(folder)) is not None:
        yield folder.parent, [_with_failure(job, read_failures(folder.parent))]
        return
    found = {name: _job(folder / name) for name in _subfolders(folder)}
    jobs = {name: job for name, job in found.items() if job is not None}
    failures = read_failures(folder)
    for name in [*read_asked(folder), *failures]:
        jobs.setdefault(name, JobStatus(name, LEFT))
    if jobs:
        yield folder, [_with_failure(job, failures) for job in jobs.values()]
    for name, job in found.items():
        if job is None:
            yield from _sweeps(folder / name)


def _subfolders(folder: Path) -> list[str]:
    """The folders in a folder, without hidden folders and links, which may lead anywhere.

    Raises:
        ResultsError: if the folder cannot be read.
    """
    try:
        with os.scandir(folder) as entries:
            return sorted(
                entry.name
                for entry in entries
                if not entry.name.startswith(".") and entry.is_dir(follow_symlinks=False)
            )
    except FileNotFoundError:  # removed meanwhile
        return []
    except OSError as error:
        raise ResultsError(f"cannot read {folder}: {error.strerror}") from None


def _with_failure(job: JobStatus, failures: dict[str, str]) -> JobStatus:
    if job.name not in failures or job.state in (DONE, RUNNING):
        return job
    return replace(job, state=FAILURE, reason=failures[job.name])


def _job(folder: Path) -> JobStatus | None:
    """The state of a job; None if the folder is not that of a job."""
    try:
        names = {path.name for path in folder.iterdir()}
        finished = (folder / RUN).is_file()
    except OSError:
        return None
    if finished:
        return _described(folder.name, DONE, read_json(folder / RUN) or {})
    if not names & MARKS or names & {SWEEP, MULTIRUN}:
        return None
    state = RUNNING if is_locked(folder) else CUT
    slots = [path for name in SLOTS for path in (folder / CHECKPOINT).glob(f"*/{name}")]
    saved = [_described(folder.name, state, _header(path)) for path in slots]
    return max(saved, key=_progress, default=JobStatus(folder.name, state))


def _progress(job: JobStatus) -> tuple[float, int]:
    return -1.0 if job.seconds is None else job.seconds, job.iterations or -1


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


def status_lines(sweep: SweepStatus, *, everything: bool = False) -> str:
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
    everything |= len(sweep.jobs) <= SHOWN
    shown = [job for job in sweep.jobs if everything or job.state != DONE]
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
    table: dict[str, Any] = {}
    if job.state == DONE:
        with suppress(ResultsError):
            table = read_table(sweep / job.name / TRIALS, {}, PASS_COLUMNS, LEARN_COLUMNS)
    passed, learned = (
        f"{int(table[name].sum())} of {len(table[name])}" if name in table else "–"
        for name in ("passed", "learned")
    )
    reason = printable(job.reason)
    return printable(job.name), job.state, iterations, passed, learned, seconds, reason
