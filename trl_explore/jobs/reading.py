"""Find jobs, and read and check their files."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trl_explore.checks import LARGEST, first_line
from trl_explore.jobs.columns import (
    CURVE_COLUMNS,
    EPISODE_COLUMNS,
    EPISODES,
    KEPT,
    LEARN_COLUMNS,
    PASS_COLUMNS,
    SCALARS,
    TIMING_COLUMNS,
    TIMINGS,
    TRIAL_COLUMNS,
    TRIALS,
    WEIGHTS,
    read_table,
)
from trl_explore.jobs.files import RUN, ResultsError, check_files, read_file
from trl_explore.statistics.outcomes import Outcomes

if TYPE_CHECKING:
    import pandas as pd


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
    "score_threshold": Field((int, float), -LARGEST), "score_window": Field((int,), 1),
}  # fmt: skip
OPTIONAL_FIELDS = {"episodes_per_update": Field((int,), 1), "first_trial": Field((int,), 0)}
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

    return pd.DataFrame(_trials(job))


def _trials(job: Path, run: dict[str, Any] | None = None) -> dict[str, NDArray[Any]]:
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


def read_episodes(job: Path) -> pd.DataFrame:
    """Read ``episodes.csv`` and check it against ``trials.csv``.

    Raises:
        ResultsError: if the file is missing, truncated or invalid.
    """
    frame, trials = _read_csv(job / EPISODES, EPISODE_COLUMNS), _trials(job)
    for name in ("trial", "iteration", "frames"):
        if frame[name].dtype.kind != "i":
            raise ResultsError(f"{job / EPISODES}: column {name} does not hold integers")
    if frame["score"].dtype.kind not in "fi" or not np.isfinite(frame["score"]).all():
        raise ResultsError(f"{job / EPISODES}: column score does not hold finite numbers")
    groups = frame.groupby(["trial", "iteration"])["frames"].agg(["size", "sum"]).reset_index()
    trial, iteration, size, total = groups.to_numpy(dtype=np.int64).T
    row = np.repeat(np.arange(len(trials["trial"])), trials["iterations"])
    begun = np.cumsum(trials["iterations"]) - trials["iterations"]
    same = (
        np.array_equal(trial, trials["trial"][row])
        and np.array_equal(iteration, np.arange(1, len(row) + 1) - begun[row])
        and bool((size == size[:1]).all())  # episodes of an iteration
        and np.array_equal(np.bincount(row, weights=total), trials["frames"])
    )
    if not same:
        raise ResultsError(f"{job / EPISODES}: its episodes do not match {TRIALS}")
    check_files(job, names=[EPISODES])
    return frame


def read_weights(job: Path, *, kept: bool = False) -> dict[str, NDArray[Any]]:
    """The weights of the final policy: name -> array [trials, ...].

    Args:
        job: the folder of the job.
        kept: the weights along the way instead, by "iteration/name"; empty if none were kept.

    Raises:
        ResultsError: if the file is missing or damaged.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    name = KEPT if kept else WEIGHTS
    path = job / name
    check_files(job, names=[name])
    try:
        return load(read_file(path))
    except FileNotFoundError:
        if kept:
            return {}
        raise ResultsError(f"{path}: missing") from None
    except (SafetensorError, OSError) as error:
        raise ResultsError(f"{path}: not readable as weights ({error})") from None


def read_timings(sweep: Path) -> pd.DataFrame | None:
    """Read and check ``timings.csv`` of a sweep; None if nothing was timed.

    Raises:
        ResultsError: if the file is truncated or invalid.
    """
    if not (sweep / TIMINGS).exists():
        return None
    frame = _read_csv(sweep / TIMINGS, TIMING_COLUMNS)
    seconds = frame["seconds"].to_numpy()
    if not (
        frame["trial"].dtype.kind == "i"
        and seconds.dtype.kind in "fi"
        and bool(np.all(np.isfinite(seconds) & (seconds > 0)))
    ):
        raise ResultsError(f"{sweep / TIMINGS}: column trial or seconds has the wrong type")
    if frame.duplicated(["experiment", "job", "trial"]).any():
        raise ResultsError(f"{sweep / TIMINGS}: a trial occurs twice")
    return frame.astype({"experiment": str, "job": str})


def read_curves(job: Path) -> pd.DataFrame:
    """The learning curves of a job, one column for each, indexed by iteration (from 1).

    Raises:
        ResultsError: if there are no curves, or a file is invalid.
    """
    import pandas as pd

    files = sorted((job / SCALARS).glob("*.csv"))
    if not files:
        raise ResultsError(f"{job / SCALARS}: no learning curves")
    curves = {}
    for file in files:
        columns = read_table(file, CURVE_COLUMNS, header=False)
        if not np.array_equal(columns["iteration"], np.arange(1, len(columns["value"]) + 1)):
            raise ResultsError(f"{file}: the iterations are not consecutive")
        curves[file.stem] = columns["value"]
    if len({len(curve) for curve in curves.values()}) > 1:
        raise ResultsError(f"{job / SCALARS}: the curves differ in length")
    check_files(job, names=[file.relative_to(job).as_posix() for file in files])
    index = pd.RangeIndex(1, 1 + len(next(iter(curves.values()))), name="iteration")
    return pd.DataFrame(curves, index=index)


def _read_csv(path: Path, columns: Iterable[str]) -> pd.DataFrame:
    import pandas as pd

    try:
        frame = pd.read_csv(BytesIO(read_file(path)))
    except FileNotFoundError:
        raise ResultsError(f"{path}: missing") from None
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path}: not readable as CSV ({first_line(error)})") from None
    missing = [name for name in columns if name not in frame.columns]
    if missing:
        raise ResultsError(f"{path}: missing column: {', '.join(missing)}")
    if not isinstance(frame.index, pd.RangeIndex):
        raise ResultsError(f"{path}: a line has more fields than the first")
    if frame[list(columns)].isna().to_numpy().any():
        raise ResultsError(f"{path}: a value is missing")
    return frame


def read_job(job: Path) -> Outcomes:
    """The outcomes of a finished job.

    Raises:
        ResultsError: if the folder holds no finished job, or its files contradict each other.
    """
    run = read_run(job)
    columns: dict[str, Any] = dict(_trials(job, run))
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
    """
    found: list[tuple[Path, bool]] = []
    below = [folder]
    while below:
        place = below.pop()
        try:
            with os.scandir(place) as entries:
                names = {e.name: e.is_dir(follow_symlinks=False) for e in entries}
        except OSError:
            continue
        if names.keys() & {RUN, ".hydra", TRIALS}:
            found.append((place, RUN in names))
        below += [
            place / name
            for name, is_folder in names.items()
            if is_folder and name[0] != "." and name != SCALARS
        ]
    return sorted(found)
