"""The records in the folder of a sweep: which jobs were requested, and why some of them failed.

    sweep.json              the requested jobs, until all of them are finished
    .failed/<job>.json      why a job failed, until it is finished

Several processes write these small files, each atomically. Both are removed when all jobs are
finished, so that an interrupted and resumed sweep leaves the same files as any other.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from trl_explore.jobs.files import RUN, read_file, write_whole
from trl_explore.jobs.lock import is_alive

SWEEP, FAILED, MULTIRUN = "sweep.json", ".failed", "multirun.yaml"
LOOKS, VERDICTS = "settle.json", "settle.csv"
"""The plan and the verdicts of a sweep to which trials were added until they were decided."""


def begin_sweep(sweep: Path, jobs: Sequence[str]) -> None:
    """Record the requested jobs; unfinished jobs of an earlier sweep stay on the list."""
    asked = dict.fromkeys([*jobs, *_unfinished(sweep, read_asked(sweep))])
    _write(sweep / SWEEP, {"jobs": list(asked)})


def end_sweep(sweep: Path) -> None:
    """Remove records that are no longer needed, and the folder if it holds no job."""
    with suppress(OSError):
        for path in [*sweep.glob(".*.tmp"), *(sweep / FAILED).glob(".*.tmp")]:
            if _is_left(path):
                path.unlink(missing_ok=True)
        if not _unfinished(sweep, read_asked(sweep)):
            (sweep / SWEEP).unlink(missing_ok=True)
        if {path.name for path in sweep.iterdir()} <= {SWEEP, FAILED, MULTIRUN}:
            for path in (*(sweep / FAILED).glob("*.json"), sweep / SWEEP, sweep / MULTIRUN):
                path.unlink(missing_ok=True)
            if (sweep / FAILED).is_dir():
                (sweep / FAILED).rmdir()
            sweep.rmdir()


def _unfinished(sweep: Path, jobs: Iterable[str]) -> list[str]:
    return [job for job in jobs if not (sweep / job / RUN).is_file()]


def read_asked(sweep: Path) -> list[str]:
    """The names of the requested jobs; none if the record is missing or not readable."""
    jobs = (read_json(sweep / SWEEP) or {}).get("jobs")
    return [job for job in jobs if is_name(job)] if isinstance(jobs, list) else []


def is_name(job: object) -> bool:
    """Whether a text read from a file is a plain file name, not a path to another place."""
    return isinstance(job, str) and job not in ("", ".", "..") and not {"/", "\0"} & set(job)


def record_failure(job: Path, reason: str) -> None:
    """Record why a job failed."""
    for last in (False, False, True):  # another process may remove the folder while it is empty
        try:
            (job.parent / FAILED).mkdir(exist_ok=True)
            _write(job.parent / FAILED / f"{job.name}.json", {"job": job.name, "reason": reason})
            return
        except FileNotFoundError:
            if last:
                raise


def forget_failure(job: Path) -> None:
    """Remove the record of a failure, because the job is finished now."""
    with suppress(OSError):
        (job.parent / FAILED / f"{job.name}.json").unlink(missing_ok=True)
        (job.parent / FAILED).rmdir()


def read_failures(sweep: Path) -> dict[str, str]:
    """The reason of each failed job, by name."""
    with suppress(OSError):
        paths = [path for path in sorted((sweep / FAILED).iterdir()) if path.suffix == ".json"]
        unknown = "the reason is not readable"
        return {path.stem: str((read_json(path) or {}).get("reason", unknown)) for path in paths}
    return {}


def read_json(path: Path) -> dict[str, Any] | None:
    """The contents of a file; None if there is none, empty if it is not readable."""
    if not path.is_file():
        return None
    try:
        content = json.loads(read_file(path))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _is_left(temporary: Path) -> bool:
    """Whether the process that wrote a temporary file of this module was killed."""
    pid = temporary.name.split(".")[1]
    return pid.isdecimal() and int(pid) != os.getpid() and not is_alive(int(pid))


def _write(path: Path, content: object) -> None:
    text = json.dumps(content, indent=1) + "\n"
    write_whole(path, text.encode(), tag=f"{os.getpid()}.")
