"""Read and check the diagnostics, visits and evaluations of a job."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.jobs.columns import (
    EPISODES,
    EVALUATION_COLUMNS,
    EVALUATIONS,
    PURPOSE_COLUMNS,
    TRIALS,
    VISITS,
    read_table,
)
from trl_explore.jobs.files import ResultsError, check_files, read_file
from trl_explore.jobs.reading import read_episodes, read_run, read_trials
from trl_explore.statistics.evaluations import (
    AUTO,
    FINAL_EPISODES,
    PURPOSES,
    evaluations_until,
)
from trl_explore.training.quantities import DIAGNOSTIC_COLUMNS, DIAGNOSTICS

if TYPE_CHECKING:
    import pandas as pd

ROUNDING = 1e-4
"""Tolerance at a bound, because the values have single precision."""


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
    present = [name for name in DIAGNOSTIC_COLUMNS if name in frame.columns]
    if not present:
        return None
    where = job / EPISODES
    if missing := [name for name in DIAGNOSTIC_COLUMNS if name not in present]:
        raise ResultsError(f"{where}: missing column: {', '.join(missing)}")
    for name in DIAGNOSTIC_COLUMNS:
        if frame[name].dtype.kind not in "fi":
            raise ResultsError(f"{where}: column {name} does not hold numbers")
        low, high = DIAGNOSTICS[name].bounds
        values = frame[name].to_numpy(np.float64)
        if ((values < low - ROUNDING) | (values > high + ROUNDING)).any():
            raise ResultsError(f"{where}: column {name} is outside the range {low:g} to {high:g}")
    keys = ["trial", "iteration"]
    rows = frame.loc[:, [*keys, *DIAGNOSTIC_COLUMNS]].drop_duplicates()
    rows = rows.sort_values(by=keys)
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
    config, trials = read_run(job)["config"], read_trials(job)
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
    scheduled = [
        (trial, int(i))
        for trial, end in last.items()
        for i in evaluations_until(end, every, cap)
        if i >= first and not (diverged[trial] and i == end)
        for _ in range(count)
    ]
    finals = [(t, end) for t, end in last.items() if not diverged[t] for _ in range(final)]
    pairs = list(zip(columns["trial"].tolist(), columns["iteration"].tolist(), strict=True))
    found = [sorted(p for p, k in zip(pairs, kinds, strict=True) if k == i) for i in range(3)]
    confirmed = all(trial in last and 0 < i <= last[trial] for trial, i in found[1])
    if not (found[0] == scheduled and found[2] == finals and confirmed):
        raise ResultsError(f"{where}: its episodes do not match {TRIALS}")
    check_files(job, names=[EVALUATIONS])
    chosen = kinds == PURPOSES.index(purpose)
    return {name: column[chosen] for name, column in columns.items()}


def read_visits(job: Path) -> dict[str, NDArray[np.int64]] | None:
    """Read where the trials of a job have been; None if it was not recorded.

    Returns:
        "iteration" [k], "visits" and "reached" [k, rows, columns]; see ``training.visits.joined``.

    Raises:
        ResultsError: if the file is truncated or invalid.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    where = job / VISITS
    if not where.exists():
        return None
    try:
        found = load(read_file(where))
    except (SafetensorError, OSError, ValueError) as error:
        raise ResultsError(f"{where}: not readable as safetensors ({error})") from None
    shapes = [found[name].shape for name in ("visits", "reached") if name in found]
    whole = len(shapes) == 2 and shapes[0] == shapes[1] and len(shapes[0]) == 3
    if not whole or found.get("iteration", np.zeros(0)).shape != shapes[0][:1]:
        raise ResultsError(f"{where}: does not hold iteration, visits and reached")
    check_files(job, names=[VISITS])
    return found
