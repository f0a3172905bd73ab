"""The trials of many jobs as one table."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trl_explore.jobs.columns import TRIAL_COLUMNS
from trl_explore.jobs.files import ResultsError
from trl_explore.jobs.reading import find_jobs, read_job
from trl_explore.statistics.outcomes import PER_TRIAL, Outcomes

if TYPE_CHECKING:
    import pandas as pd

LABELS = ("experiment", "job", "folder", "strategy")


def read_jobs(folders: Iterable[Path | str] | Path | str) -> list[Outcomes]:
    """The outcomes of all finished jobs at or below one or more folders, each job once.

    Raises:
        ResultsError: if a folder does not exist, or a job cannot be read.
    """
    return [read_job(job) for job in _finished(folders)]


def read_frame(folders: Iterable[Path | str] | Path | str) -> pd.DataFrame:
    """The trials of all finished jobs at or below one or more folders, one row for each trial.

    The columns are ``experiment``, ``job``, ``folder``, ``strategy``, one for each value of the
    configuration, and those of ``trials.csv``. A configuration has the columns ``optimizer.lr``,
    ``env.id`` and so on, with the trial's own value if it has one per trial; ``correction``,
    ``baseline``, ``policy`` and the other groups hold the name of the class. A value that a job
    does not have is missing (NaN or None).

    Raises:
        ResultsError: if a folder does not exist, or a job cannot be read.
    """
    import pandas as pd

    parts: list[dict[str, Any]] = []
    for folder in _finished(folders):
        job = read_job(folder)
        labels = (job.experiment, job.name, str(folder), job.strategy)
        values: dict[str, Any] = dict(zip(LABELS, labels, strict=True))
        strategy = {f"strategy.{key}": value for key, value in job.parameters.items()}
        values |= dict(_flat({**strategy, **job.config}))
        taken = {name: getattr(job, name) for name in PER_TRIAL}
        found = {name: column for name, column in taken.items() if column is not None}
        parts.append({k: _of_trials(v, len(job)) for k, v in values.items()} | found)
    if not parts:
        return pd.DataFrame(columns=[*LABELS, *TRIAL_COLUMNS])
    frame = pd.concat([pd.DataFrame(part) for part in parts], ignore_index=True)
    last = [name for name in PER_TRIAL if name in frame]
    return frame.reindex(columns=[*(name for name in frame if name not in last), *last])


def _finished(folders: Iterable[Path | str] | Path | str) -> list[Path]:
    """The folders of the finished jobs, each once, however often and through whatever link."""
    given = [folders] if isinstance(folders, str | os.PathLike) else list(folders)
    found: dict[Path, Path] = {}
    for folder in map(Path, given):
        if not folder.is_dir():
            raise ResultsError(f"{folder}: no such folder")
        for job in find_jobs(folder):
            found.setdefault(job.resolve(), job)
    return list(found.values())


def _flat(node: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every value of a configuration with its key; of a constructor, the name of the class."""
    for key, value in node.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        elif key == "_target_":
            if prefix != "strategy.":
                yield prefix.rstrip("."), str(value).rpartition(".")[2]
        elif f"{prefix}{key}" not in PER_TRIAL and not key.startswith("_"):
            yield f"{prefix}{key}", value


def _of_trials(value: Any, trials: int) -> Any:
    """The value of each trial: a list with one number for each, or the same value for all."""
    if isinstance(value, list):
        numbers = all(isinstance(x, int | float) for x in value)
        if len(value) == trials and numbers and trials > 1:
            return np.array(value)
        value = json.dumps(value)
    return [value] * trials
