"""Whether the files of a finished job are those that were written."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trl_explore.jobs.columns import EPISODES, EVALUATIONS, SCALARS, TRIALS, WEIGHTS, ResultsError


def record(job: Path) -> dict[str, dict[str, Any]]:
    """Length in bytes and SHA-256 of every file that a job has written, for ``run.json``."""
    names = (TRIALS, EPISODES, EVALUATIONS, WEIGHTS)
    paths = [job / name for name in names] + sorted((job / SCALARS).glob("*.csv"))
    return {
        path.relative_to(job).as_posix(): {"bytes": path.stat().st_size, "sha256": _sha256(path)}
        for path in paths
        if path.is_file()
    }


def check_whole(job: Path, run: Mapping[str, Any], *, deep: bool = False) -> None:
    """Hold the files of a finished job against what ``run.json`` says of them.

    Args:
        job: the folder.
        run: the contents of ``run.json``; one without a record of the files passes.
        deep: whether to read the files, not only to look at their lengths.

    Raises:
        ResultsError: naming the first file that is missing or another.
    """
    files = run.get("files", {})
    if not isinstance(files, Mapping):
        raise ResultsError(f"{job}: run.json does not say which files there are")
    for name, expected in files.items():
        path = job / name
        if not path.resolve().is_relative_to(job.resolve()) or not isinstance(expected, Mapping):
            raise ResultsError(f"{job}: run.json names {name!r}, which is no file of a job")
        if not path.is_file():
            raise ResultsError(f"{path}: missing")
        if (size := path.stat().st_size) != expected.get("bytes"):
            raise ResultsError(f"{path}: damaged ({size} bytes, not {expected.get('bytes')})")
        if deep and _sha256(path) != expected.get("sha256"):
            raise ResultsError(f"{path}: damaged (it is not what was written)")


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
