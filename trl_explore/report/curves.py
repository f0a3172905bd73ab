"""What was recorded along the runs, as curves: scores, diagnostics, evaluations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from trl_explore.jobs.columns import EPISODES, ResultsError
from trl_explore.jobs.reading import read_curves, read_episodes
from trl_explore.jobs.records import read_diagnostics, read_evaluations
from trl_explore.report.figures.learning import Row
from trl_explore.report.groups import Group
from trl_explore.report.loading import Gap, Job, gap
from trl_explore.training.columns import DIAGNOSTIC_COLUMNS

POINTS = 240
"""Most iterations at which a curve is drawn."""
FEWER_POINTS = 60
"""The same for diagnostics, of which there are many figures."""
SMOOTH = 20
"""Iterations that a diagnostic is averaged over."""


@dataclass(frozen=True, eq=False)
class Traces:
    """The curves of a group, each list in the order of its configurations.

    Attributes:
        learning: running score, mean over trials, with the middle half of them.
        diagnostics: quantity -> its curves, median over trials with the middle half of them;
            empty where nothing was recorded.
        evaluations: name of a configuration -> score in training and score of the greedy policy,
            means over trials.
        gaps: what could not be read.

    """

    learning: list[Row] = field(default_factory=list)
    diagnostics: dict[str, dict[str, Row]] = field(default_factory=dict)
    evaluations: dict[str, tuple[Row, Row]] = field(default_factory=dict)
    gaps: list[Gap] = field(default_factory=list)


def running_means(
    trial: NDArray[np.int64],
    iteration: NDArray[np.int64],
    values: NDArray[np.float64],
    window: int,
    at: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Mean of the last ``window`` rows of every trial, at some iterations.

    A trial that has stopped carries its last value forward; nan is left out, and is the result
    where there is nothing else.

    Args:
        trial: of each row [n].
        iteration: of each row [n], from 1.
        values: [n].
        window: number of rows; before so many exist, the mean is over those there are.
        at: iterations [k], from 1; before the first row of a trial its first value counts.

    Returns:
        [k, n_trials], trials in ascending order.

    """
    order = np.lexsort((iteration, trial))
    iteration, values = iteration[order], values[order]
    names, place = np.unique(trial[order], return_inverse=True)
    starts = np.searchsorted(place, np.arange(len(names) + 1))
    known = np.isfinite(values)
    total = np.concatenate([[0.0], np.cumsum(np.where(known, values, 0.0))])
    count = np.concatenate([[0], np.cumsum(known)])
    result = np.empty((len(at), len(names)))
    for k in range(len(names)):
        first, last = starts[k], starts[k + 1]
        # One past the last row with iteration ≤ at.
        end = first + np.searchsorted(iteration[first:last], at, side="right")
        end = np.maximum(end, first + 1)
        begin = np.maximum(first, end - window)
        n = count[end] - count[begin]
        mean = (total[end] - total[begin]) / np.maximum(n, 1)
        result[:, k] = np.where(n > 0, mean, np.nan)
    return result


def running_scores(
    episodes: pd.DataFrame, window: int, at: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Mean score over the last ``window`` episodes of every trial: see :func:`running_means`.

    Args:
        episodes: columns trial, iteration (from 1) and score.
        window: number of episodes.
        at: iterations [k], from 1.

    Returns:
        [k, n_trials], trials in ascending order.

    """
    return running_means(*_columns(episodes, "score"), window, at)


def read_traces(group: Group) -> Traces:
    """Everything that was recorded along the runs of a group; files are read once."""
    traces = Traces(diagnostics={name: {} for name in DIAGNOSTIC_COLUMNS})
    end = max(int(c.iterations.max()) for c in group.configurations)
    for c in group.configurations:
        style, label = group.styles[c.name], group.labels[c.name]
        parts = _Parts()
        for job in group.jobs[c.name]:
            parts.read(job, group.window, end)
        traces.gaps.extend(parts.gaps)
        if (row := parts.learning(label, style)) is not None:
            traces.learning.append(row)
        for name, tables in parts.diagnostics.items():
            if (row := _middle(_grid(end, FEWER_POINTS), tables, label, style)) is not None:
                traces.diagnostics[name][c.name] = row
        if parts.evaluations and parts.scores:
            at = _grid(end)
            rows = [
                Row(name, at.astype(np.float64), np.concatenate(t, axis=1).mean(axis=1), None,
                    None, style)
                for name, t in (("training", parts.scores), ("greedy", parts.evaluations))
            ]  # fmt: skip
            traces.evaluations[c.name] = (rows[0], rows[1])
    for name in [name for name, rows in traces.diagnostics.items() if not rows]:
        del traces.diagnostics[name]
    return traces


class _Parts:
    """What the jobs of one configuration recorded, job by job: tables [k, n_trials]."""

    def __init__(self) -> None:
        self.at = np.zeros(0, dtype=np.int64)
        self.scores: list[NDArray[np.float64]] = []
        self.means: list[NDArray[np.float64]] = []
        self.weights: list[int] = []
        self.diagnostics: dict[str, list[NDArray[np.float64]]] = {}
        self.evaluations: list[NDArray[np.float64]] = []
        self.gaps: list[Gap] = []

    def read(self, job: Job, window: int, end: int) -> None:
        """Add a job."""
        self.at = _grid(end)
        try:
            episodes = read_episodes(job.folder)
        except ResultsError as error:
            if (job.folder / EPISODES).exists():
                self.gaps.append(gap(job.folder, error))
            self._curve(job)
            return
        self.scores.append(running_scores(episodes, window, self.at))
        try:
            self._details(job, episodes, end)
        except ResultsError as error:
            self.gaps.append(gap(job.folder, error))

    def _curve(self, job: Job) -> None:
        try:
            self.means.append(_mean(job, self.at))
            self.weights.append(len(job.outcomes))
        except ResultsError:
            return

    def _details(self, job: Job, episodes: pd.DataFrame, end: int) -> None:
        rows = read_diagnostics(job.folder, episodes)
        if rows is not None:
            at = _grid(end, FEWER_POINTS)
            for name in DIAGNOSTIC_COLUMNS:
                table = running_means(*_columns(rows, name), SMOOTH, at)
                self.diagnostics.setdefault(name, []).append(table)
        played = read_evaluations(job.folder)
        if played is not None and len(played["trial"]):
            # The episodes of one evaluation have the same iteration.
            count = int(np.unique(played["trial"] * 2**32 + played["iteration"],
                                  return_counts=True)[1].max())  # fmt: skip
            self.evaluations.append(
                running_means(played["trial"], played["iteration"], played["score"], count, self.at)
            )

    def learning(self, label: str, style: Any) -> Row | None:
        """The learning curve, with a band where every job recorded its episodes."""
        x = self.at.astype(np.float64)
        if self.scores and not self.means:
            table = np.concatenate(self.scores, axis=1)
            low, high = np.quantile(table, [0.25, 0.75], axis=1)
            return Row(label, x, table.mean(axis=1), low, high, style)
        if self.means or self.scores:
            parts = [*self.means, *(s.mean(axis=1) for s in self.scores)]
            sizes = [*self.weights, *(s.shape[1] for s in self.scores)]
            return Row(label, x, np.average(parts, axis=0, weights=sizes), None, None, style)
        return None


def _middle(
    at: NDArray[np.int64], tables: Sequence[NDArray[np.float64]], label: str, style: Any
) -> Row | None:
    """Median and middle half over the trials that have a value; None where none has."""
    table = np.concatenate(list(tables), axis=1)
    known = np.isfinite(table).any(axis=1)
    if not known.any():
        return None
    low, middle, high = np.nanquantile(table[known], [0.25, 0.5, 0.75], axis=1)
    return Row(label, at[known].astype(np.float64), middle, low, high, style)


def _columns(
    frame: pd.DataFrame, name: str
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    return (
        frame["trial"].to_numpy(np.int64),
        frame["iteration"].to_numpy(np.int64),
        frame[name].to_numpy(np.float64),
    )


def _grid(end: int, points: int = POINTS) -> NDArray[np.int64]:
    return np.unique(np.linspace(1, end, points).round().astype(np.int64))


def _mean(job: Job, at: NDArray[np.int64]) -> NDArray[np.float64]:
    try:
        curves = read_curves(job.folder)
        curve = curves["score"].dropna().to_numpy(np.float64)
    except (ValueError, KeyError, OSError) as error:
        raise ResultsError(f"{job.folder}: no learning curve ({error})") from None
    if not len(curve):
        raise ResultsError(f"{job.folder}: an empty learning curve")
    return curve[np.minimum(at, len(curve)) - 1]
