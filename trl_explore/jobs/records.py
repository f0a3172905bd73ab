"""Reading what a job recorded beside its scores: diagnostics and evaluations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.jobs.columns import (
    EPISODES,
    EVALUATION_COLUMNS,
    EVALUATIONS,
    TRIALS,
    ResultsError,
)
from trl_explore.jobs.reading import read_episodes, read_run, read_trials
from trl_explore.jobs.tables import Parser, integers, numbers, read_table
from trl_explore.training.columns import DIAGNOSTIC_COLUMNS, DIAGNOSTICS

if TYPE_CHECKING:
    import pandas as pd

ROUNDING = 1e-4
"""By which single precision may pass a bound."""
EVALUATION_PARSERS: dict[str, Parser] = dict(
    zip(EVALUATION_COLUMNS, (integers, integers, numbers), strict=True)
)


def read_diagnostics(job: Path, episodes: pd.DataFrame | None = None) -> pd.DataFrame | None:
    """The diagnostics of a job, one row per trial and iteration, checked.

    Args:
        job: folder of a finished job.
        episodes: what ``read_episodes`` gave for it, if that was read already.

    Returns:
        The columns trial, iteration and ``DIAGNOSTIC_COLUMNS`` (nan: no value), ordered by trial
        and iteration; None where none were recorded.

    Raises:
        ResultsError: if there are no episodes, or the columns are not what they should be.
    """
    frame = read_episodes(job) if episodes is None else episodes
    present = [name for name in DIAGNOSTIC_COLUMNS if name in frame.columns]
    if not present:
        return None
    where = job / EPISODES
    if missing := [name for name in DIAGNOSTIC_COLUMNS if name not in present]:
        raise ResultsError(f"{where}: no column {', '.join(missing)}")
    for name in DIAGNOSTIC_COLUMNS:
        if frame[name].dtype.kind not in "fi":
            raise ResultsError(f"{where}: column {name} is not of numbers")
        low, high = DIAGNOSTICS[name].bounds
        values = frame[name].to_numpy(np.float64)
        if ((values < low - ROUNDING) | (values > high + ROUNDING)).any():
            raise ResultsError(f"{where}: column {name} leaves the range {low:g} to {high:g}")
    keys = ["trial", "iteration"]
    rows = frame.loc[:, [*keys, *DIAGNOSTIC_COLUMNS]].drop_duplicates()
    rows = rows.sort_values(by=keys)
    if rows.duplicated(keys).any():
        raise ResultsError(f"{where}: episodes of one iteration differ in their diagnostics")
    return rows.reset_index(drop=True)


def read_evaluations(job: Path) -> dict[str, NDArray[Any]] | None:
    """``evaluations.csv`` of a job, one entry per episode, held against its trials.

    Returns:
        trial and iteration (int64) and score (float64) [n], in the order of the file; None where
        nothing was evaluated.

    Raises:
        ResultsError: if the file is truncated or foreign.
    """
    where = job / EVALUATIONS
    if not where.exists():
        return None
    columns = read_table(where, EVALUATION_PARSERS)
    config, trials = read_run(job)["config"], read_trials(job)
    every, count = config.get("evaluate_every"), config.get("evaluate_episodes", 1)
    if not isinstance(every, int) or not isinstance(count, int) or every < 1 or count < 1:
        raise ResultsError(f"{where}: the job was configured without evaluations")
    expected = [
        (trial, i)
        for trial, last in zip(trials["trial"], trials["iterations"], strict=True)
        for i in range(every, last + 1, every)
        for _ in range(count)
    ]
    found = sorted(zip(columns["trial"].tolist(), columns["iteration"].tolist(), strict=True))
    if found != expected:
        raise ResultsError(f"{where}: its episodes are not those of {TRIALS}")
    return columns
