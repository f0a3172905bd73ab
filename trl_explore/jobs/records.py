"""Read and check what a job records beside its outcomes, and the timings of a sweep."""

from __future__ import annotations

from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.checks import first_line
from trl_explore.jobs.columns import (
    CURVE_COLUMNS,
    EPISODE_COLUMNS,
    EPISODES,
    EVALUATION_COLUMNS,
    EVALUATIONS,
    KEPT,
    PURPOSE_COLUMNS,
    SCALARS,
    TIMING_COLUMNS,
    TIMINGS,
    TRIALS,
    VISITS,
    WEIGHTS,
    check_present,
    read_table,
)
from trl_explore.jobs.files import ResultsError, check_files, read_file
from trl_explore.jobs.reading import read_columns, read_run
from trl_explore.statistics.evaluations import AUTO, FINAL_EPISODES, PURPOSES, evaluations_until
from trl_explore.training.diagnostic_quantities import DIAGNOSTIC_COLUMNS, DIAGNOSTICS

if TYPE_CHECKING:
    import pandas as pd

ROUNDING = 1e-4
"""Tolerance at a bound, because the values have single precision."""


def read_episodes(job: Path) -> pd.DataFrame:
    """Read ``episodes.csv`` and check it against ``trials.csv``.

    Raises:
        ResultsError: if the file is missing, truncated or invalid.
    """
    frame, trials = _read_csv(job / EPISODES, EPISODE_COLUMNS), read_columns(job)
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
    path = job / (KEPT if kept else WEIGHTS)
    check_files(job, names=[path.name])
    return {} if kept and not path.exists() else _arrays(path, "weights")


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
    check_present(path, columns, frame.columns)
    if not isinstance(frame.index, pd.RangeIndex):
        raise ResultsError(f"{path}: a line has more fields than the first")
    if frame[list(columns)].isna().to_numpy().any():
        raise ResultsError(f"{path}: a value is missing")
    return frame


def read_diagnostics(job: Path, episodes: pd.DataFrame | None = None) -> pd.DataFrame | None:
    """Read and check the diagnostics of a job, one row per trial and iteration.

    Args:
        job: folder of a finished job.
        episodes: the result of ``read_episodes`` for it, if already read.

    Returns:
        The columns trial, iteration and ``DIAGNOSTIC_COLUMNS`` (nan: no value), ordered by trial
        and iteration; None if no diagnostics were recorded.

    Raises:
        ResultsError: if there are no episodes, or a column is missing or invalid.
    """
    frame = read_episodes(job) if episodes is None else episodes
    where = job / EPISODES
    if not {*DIAGNOSTIC_COLUMNS} & {*frame.columns}:
        return None
    check_present(where, DIAGNOSTIC_COLUMNS, frame.columns)
    for name in DIAGNOSTIC_COLUMNS:
        if frame[name].dtype.kind not in "fi":
            raise ResultsError(f"{where}: column {name} does not hold numbers")
        low, high = DIAGNOSTICS[name].bounds
        values = frame[name].to_numpy(np.float64)
        if ((values < low - ROUNDING) | (values > high + ROUNDING)).any():
            raise ResultsError(f"{where}: column {name} is outside the range {low:g} to {high:g}")
    keys = ["trial", "iteration"]
    rows = frame.loc[:, [*keys, *DIAGNOSTIC_COLUMNS]].drop_duplicates().sort_values(by=keys)
    if rows.duplicated(keys).any():
        raise ResultsError(f"{where}: the diagnostics differ between episodes of one iteration")
    return rows.reset_index(drop=True)


def read_evaluations(job: Path, purpose: str = "scheduled") -> dict[str, NDArray[Any]] | None:
    """Read ``evaluations.csv`` of a job, one entry per episode, and check it against the trials.

    Args:
        job: folder of a finished job.
        purpose: ``scheduled``, ``confirmation`` or ``final``.

    Returns:
        trial and iteration (int64) and score (float64) [n], in the order of the file; None if
        nothing was evaluated.

    Raises:
        ResultsError: if the file is truncated or invalid.
    """
    where = job / EVALUATIONS
    if not where.exists():
        return None
    columns = read_table(where, EVALUATION_COLUMNS, PURPOSE_COLUMNS)
    config, trials = read_run(job)["config"], read_columns(job)
    every, count = config.get("evaluate_every"), config.get("evaluate_episodes", 1)
    whole = all(isinstance(x, int) and x >= 1 for x in (count, 1 if every == AUTO else every))
    if not whole:
        raise ResultsError(f"{where}: the configuration of the job has no evaluations")
    last = dict(zip(trials["trial"].tolist(), trials["iterations"].tolist(), strict=True))
    diverged = dict(zip(trials["trial"], trials["status"] == "diverged", strict=True))
    kinds = columns.pop("purpose", None)
    if kinds is None:  # a file of an older version
        kinds, first, cap, final = np.zeros(len(columns["trial"]), np.int64), 1, 0, 0
    else:
        first, cap, final = 0, config["max_iterations"], FINAL_EPISODES
    due = [
        (trial, int(i))
        for trial, end in last.items()
        for i in evaluations_until(end, every, cap)
        if i >= first and not (diverged[trial] and i == end)
    ]
    finals = [(t, end) for t, end in last.items() if not diverged[t] for _ in range(final)]
    pairs = list(zip(columns["trial"].tolist(), columns["iteration"].tolist(), strict=True))
    found = [sorted(p for p, k in zip(pairs, kinds, strict=True) if k == i) for i in range(3)]
    # The number first: the list of a damaged number would not fit into memory.
    scheduled = len(found[0]) == count * len(due) and found[0] == sorted(count * due)
    confirmed = all(trial in last and 0 < i <= last[trial] for trial, i in found[1])
    if not (scheduled and found[2] == finals and confirmed):
        raise ResultsError(f"{where}: its episodes do not match {TRIALS}")
    check_files(job, names=[EVALUATIONS])
    chosen = kinds == PURPOSES.index(purpose)
    return {name: column[chosen] for name, column in columns.items()}


def read_visits(job: Path) -> dict[str, NDArray[np.int64]] | None:
    """Read where the trials of a job have been; None if it was not recorded.

    Returns:
        "iteration" [k], "visits" and "reached" [k, rows, columns]; see ``Visits.joined``.

    Raises:
        ResultsError: if the file is truncated or invalid.
    """
    where = job / VISITS
    if not where.exists():
        return None
    found = _arrays(where, "safetensors")
    shapes = [found[name].shape for name in ("visits", "reached") if name in found]
    whole = len(shapes) == 2 and shapes[0] == shapes[1] and len(shapes[0]) == 3
    if not whole or found.get("iteration", np.zeros(0)).shape != shapes[0][:1]:
        raise ResultsError(f"{where}: does not hold iteration, visits and reached")
    check_files(job, names=[VISITS])
    return found


def _arrays(path: Path, kind: str) -> dict[str, NDArray[Any]]:
    """The arrays of a safetensors file, by name."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        return load(read_file(path))
    except FileNotFoundError:
        raise ResultsError(f"{path}: missing") from None
    except (SafetensorError, OSError, ValueError) as error:
        raise ResultsError(f"{path}: not readable as {kind} ({error})") from None
