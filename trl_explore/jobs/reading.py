"""Find jobs, and read their outcomes: ``run.json`` and ``trials.csv``, one job or many."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from sys import float_info
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trl_explore.checks import LARGEST
from trl_explore.jobs.columns import (
    LEARN_COLUMNS,
    PASS_COLUMNS,
    SCALARS,
    TRIAL_COLUMNS,
    TRIALS,
    read_table,
)
from trl_explore.jobs.files import RUN, ResultsError, check_files, read_file
from trl_explore.statistics.outcomes import PER_TRIAL, Outcomes

if TYPE_CHECKING:
    import pandas as pd

FINITE = float_info.max
LABELS = ("experiment", "job", "folder", "strategy")
"""The first columns of ``read_frame``."""


class Field(NamedTuple):
    """A value of a record: its types, and the bounds of a number."""

    types: tuple[type, ...]
    low: float = -math.inf
    high: float = LARGEST

    def allows(self, value: Any) -> bool:
        """Whether a value that was read is one that this program writes."""
        if isinstance(value, bool) or not isinstance(value, self.types):
            return False
        return not isinstance(value, int | float) or self.low <= value <= self.high


RUN_FIELDS = {
    "config": Field((dict,)), "strategy": Field((str,)), "experiment": Field((str,)),
    "trials": Field((int,), 1), "versions": Field((dict,)), "seed": Field((int,), 0),
    "collector": Field((str,)), "seconds": Field((int, float), 0), "machine": Field((dict,)),
}  # fmt: skip
CONFIG_FIELDS = {
    "strategy": Field((dict,)), "max_iterations": Field((int,), 1),
    "score_threshold": Field((int, float), -FINITE, FINITE), "score_window": Field((int,), 1),
}  # fmt: skip
OPTIONAL_FIELDS = {
    "episodes_per_update": Field((int,), 1), "first_trial": Field((int,), 0),
    "evaluate_episodes": Field((int,), 1, 10**6),
}  # fmt: skip
"""Of the configuration; older versions have none."""


def is_finished(job: Path) -> bool:
    """Whether the folder holds a finished job."""
    return (job / RUN).is_file()


def read_run(job: Path) -> dict[str, Any]:
    """``run.json`` of a finished job.

    Raises:
        ResultsError: if it is missing or invalid.
    """
    try:
        run = json.loads(read_file(job / RUN))
        _check(run, RUN_FIELDS)
        _check(run["config"], CONFIG_FIELDS)
        _check(run["config"], {k: f for k, f in OPTIONAL_FIELDS.items() if k in run["config"]})
    except FileNotFoundError:
        raise ResultsError(f"{job}: not a finished job ({RUN} is missing)") from None
    except PermissionError as error:
        raise ResultsError(f"cannot read {job / RUN}: {error.strerror}") from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ResultsError(f"{job / RUN}: not a valid record of a job ({reason})") from None
    return run


def _check(record: dict[str, Any], fields: dict[str, Field]) -> None:
    for key, field in fields.items():
        if not field.allows(record[key]):
            raise TypeError(f"{key} is {str(record[key])[:30]!r}")


def read_trials(job: Path) -> pd.DataFrame:
    """Read and check ``trials.csv``.

    Raises:
        ResultsError: if the file is missing, truncated or invalid.
    """
    import pandas as pd

    return pd.DataFrame(read_columns(job))


def read_columns(job: Path, run: dict[str, Any] | None = None) -> dict[str, NDArray[Any]]:
    """The columns of ``trials.csv``, each [n_trials]; ``run``: the contents of ``run.json``."""
    columns = read_table(job / TRIALS, TRIAL_COLUMNS, PASS_COLUMNS, LEARN_COLUMNS)
    if (columns["iterations"] < 1).any() or (columns["frames"] < 1).any():
        raise ResultsError(f"{job / TRIALS}: a trial has no iterations or no frames")
    if (np.diff(columns["trial"]) != 1).any():
        raise ResultsError(f"{job / TRIALS}: the trials are not consecutive")
    if (columns["converged"] != (columns["status"] == "converged")).any():
        raise ResultsError(f"{job / TRIALS}: status and converged contradict each other")
    for event, name, least in (("passed", "pass", 1), ("learned", "learn", 0)):
        if event not in columns:
            continue
        for kind, low in (("iterations", least), ("frames", least)):
            until, total = columns[f"{kind}_to_{name}"], columns[kind]
            if ((until < low) | (until > total) | (~columns[event] & (until != total))).any():
                raise ResultsError(
                    f"{job / TRIALS}: {kind}_to_{name} contradicts {event} or {kind}"
                )
    check_files(job, run, [TRIALS])
    return columns


def read_job(job: Path) -> Outcomes:
    """The outcomes of a finished job.

    Raises:
        ResultsError: if the folder holds no finished job, or its files contradict each other.
    """
    run = read_run(job)
    columns: dict[str, Any] = dict(read_columns(job, run))
    config = run["config"]
    if len(columns["trial"]) != run["trials"]:
        raise ResultsError(
            f"{job / TRIALS}: {len(columns['trial'])} trials, expected {run['trials']}"
        )
    if (columns["seed"] != run["seed"]).any():
        raise ResultsError(f"{job / TRIALS}: a trial has another seed than {run['seed']}")
    parameters = {k: v for k, v in config["strategy"].items() if not k.startswith("_")}
    return Outcomes(
        name=job.name,
        experiment=run["experiment"],
        strategy=run["strategy"],
        parameters=parameters,
        config=config,
        cap=config["max_iterations"],
        threshold=config["score_threshold"],
        window=config["score_window"],
        provenance={k: run[k] for k in ("versions", "seed", "collector", "seconds", "machine")},
        **columns,
    )


def find_jobs(folder: Path) -> list[Path]:
    """The folders of all finished jobs at or below ``folder``, sorted."""
    return [job for job, finished in find_folders(folder) if finished]


def find_folders(folder: Path) -> list[tuple[Path, bool]]:
    """The folders of all jobs at or below ``folder``, sorted, and whether each is finished.

    Hidden folders and links to folders are skipped: a link may lead anywhere.

    Raises:
        ResultsError: if a folder cannot be read.
    """
    found: list[tuple[Path, bool]] = []
    below = [folder]
    while below:
        place = below.pop()
        try:
            with os.scandir(place) as entries:
                names = {e.name: e.is_dir(follow_symlinks=False) for e in entries}
        except FileNotFoundError:  # removed meanwhile
            continue
        except OSError as error:
            raise ResultsError(f"cannot read {place}: {error.strerror}") from None
        if names.keys() & {RUN, ".hydra", TRIALS}:
            found.append((place, RUN in names))
        below += [
            place / name
            for name, is_folder in names.items()
            if is_folder and name[0] != "." and name != SCALARS
        ]
    return sorted(found)


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
