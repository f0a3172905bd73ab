"""Whole files: written atomically, and compared with what ``run.json`` records of them."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

RUN = "run.json"
SMALL = 2**16
"""Size up to which a file is always compared with its digest; a larger one when it is used [B]."""


class ResultsError(ValueError):
    """A folder whose files are missing or invalid; the message is one line."""


def read_file(path: Path) -> bytes:
    """The contents of a regular file; a pipe in a folder of results would block its reader.

    Raises:
        OSError: if the file cannot be read, or is not a regular file.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return path.read_bytes()


def record(job: Path, paths: Iterable[Path]) -> dict[str, dict[str, Any]]:
    """The length in bytes and SHA-256 of the files that exist, by name in the folder."""
    return {
        path.relative_to(job).as_posix(): {"bytes": path.stat().st_size, "sha256": _digest(path)}
        for path in paths
        if path.is_file()
    }


def flaws(
    job: Path,
    run: Mapping[str, Any] | None = None,
    names: Iterable[str] | None = None,
    *,
    up_to: float = math.inf,
) -> Iterator[str]:
    """The files of a finished job that are not those that ``run.json`` records, one line for each.

    Args:
        job: the folder.
        run: the contents of ``run.json``; None: they are read. A job of an older version has no
            record of its files, and no flaws.
        names: the files to look at; None: all.
        up_to: the largest file whose digest is compared [B]; of others, only the length is.
    """
    if run is None:
        try:
            run = json.loads(read_file(job / RUN))
        except (OSError, ValueError, RecursionError):
            return  # not finished, or not readable, which ``read_run`` reports
    files = run.get("files", {}) if isinstance(run, dict) else {}
    if not isinstance(files, Mapping):
        yield f"{job / RUN}: its list of files is not valid"
        return
    for name, expected in files.items():
        if names is not None and name not in names:
            continue
        path, parts = job / name, PurePosixPath(name).parts
        if not parts or parts[0] == "/" or ".." in parts or not isinstance(expected, Mapping):
            yield f"{job / RUN}: names {name!r}, which is not a file of a job"
        elif not path.is_file():
            yield f"{path}: missing"
        elif (size := path.stat().st_size) != expected.get("bytes"):
            yield f"{path}: damaged ({size} bytes, expected {expected.get('bytes')})"
        elif size <= up_to and _digest(path) != expected.get("sha256"):
            yield f"{path}: changed since the job finished ({RUN} has another SHA-256)"


def check_files(
    job: Path,
    run: Mapping[str, Any] | None = None,
    names: Iterable[str] | None = None,
    *,
    up_to: float = math.inf,
) -> None:
    """Raise a ``ResultsError`` with the first of the ``flaws``."""
    for flaw in flaws(job, run, names, up_to=up_to):
        raise ResultsError(flaw)


def _digest(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ResultsError(f"{path}: not readable ({error.strerror})") from None


def write_whole(path: Path, data: bytes, tag: str = "") -> None:
    """Write a file atomically: it is complete or unchanged, even after a power failure.

    After a power failure the previous file may reappear, because the folder is not synced.

    Args:
        path: the file.
        data: its contents.
        tag: prefix for the name of the temporary file, if several processes write the same file.

    Raises:
        OSError: with the name of the file, if it cannot be written; an existing file stays
            unchanged.
    """
    temporary = path.with_name(f".{tag}{path.name[:200]}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise named(error, path) from None
        raise


def named(error: OSError, path: Path) -> OSError:
    """The error with the file name added: the error of a full disk names no file."""
    return error if error.errno is None else OSError(error.errno, error.strerror, str(path))
