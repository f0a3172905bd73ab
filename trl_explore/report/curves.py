"""Curves of what was recorded during training: scores, diagnostics, evaluations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from trl_explore.jobs.columns import EPISODES
from trl_explore.jobs.files import ResultsError
from trl_explore.jobs.records import (
    read_curves,
    read_diagnostics,
    read_episodes,
    read_evaluations,
    read_visits,
)
from trl_explore.report.groups import Group
from trl_explore.report.loading import Gap, Job, gap
from trl_explore.statistics.decomposition import curve_means, same_weights
from trl_explore.training.diagnostic_quantities import DIAGNOSTICS

POINTS = 240
"""Most points of a curve."""
FEWER_POINTS = 60
"""Most points of a diagnostic's curve, since there are many such figures."""
SMOOTH = 20
"""Number of iterations over which a diagnostic is averaged."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A mean or median [k] by ``iterations`` [k], with the middle half of the trials if known."""

    iterations: NDArray[np.float64]
    mean: NDArray[np.float64]
    low: NDArray[np.float64] | None = None
    high: NDArray[np.float64] | None = None

    @property
    def level(self) -> float:
        """Mean over the iterations."""
        return float(np.mean(self.mean))


@dataclass(frozen=True, eq=False)
class Traces:
    """The curves of a group by configuration name, in the order of the group.

    Attributes:
        learning: running score, mean over trials with the middle half.
        diagnostics: quantity that was recorded -> its curves, median with the middle half.
        evaluations: score in training and score of the greedy policy, means over trials.
        visits: where the trials of the first job have been, see ``read_visits``.
        heights: mean heights of the curves of every trial.
        gaps: what could not be read.
    """

    learning: dict[str, Curve] = field(default_factory=dict)
    diagnostics: dict[str, dict[str, Curve]] = field(default_factory=dict)
    evaluations: dict[str, tuple[Curve, Curve]] = field(default_factory=dict)
    visits: dict[str, dict[str, NDArray[np.int64]]] = field(default_factory=dict)
    heights: dict[str, Heights] = field(default_factory=dict)
    gaps: list[Gap] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Heights:
    """Mean scores of every trial over its training, without and with exploration, each [n].

    Attributes:
        keys: (seed, trial) of each trial.
        learned: mean height of the learned curve; a trial that stopped keeps its last value up to
            the cap.
        evaluated: the same over those evaluations that have a training episode with the same
            weights, up to the last of them.
        behaved: mean height of the curve of these training episodes.
    """

    keys: Sequence[tuple[int, int]]
    learned: NDArray[np.float64]
    evaluated: NDArray[np.float64]
    behaved: NDArray[np.float64]


def running_means(
    trial: NDArray[np.int64],
    iteration: NDArray[np.int64],
    values: NDArray[np.float64],
    window: int,
    at: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Mean of the last ``window`` rows (or all before) of every trial, at given iterations.

    Stopped trials keep their last mean. NaN values are ignored; the mean is NaN if there are no
    others.

    Args:
        trial: trial of each row [n].
        iteration: its iteration, from 1 [n].
        values: its value [n].
        window: number of rows.
        at: iterations [k], from 1; before a trial's first row, its first value counts.

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


def read_traces(group: Group) -> Traces:
    """Read everything that was recorded during the training of a group, each file once."""
    traces = Traces()
    end = max(int(c.iterations.max()) for c in group.configurations)
    for c in group.configurations:
        parts = _Parts(end, group.window)
        for job in group.jobs[c.name]:
            parts.read(job)
        if (visits := parts.visits(group.jobs[c.name][0])) is not None:
            traces.visits[c.name] = visits
        traces.gaps.extend(parts.gaps)
        if (curve := parts.learning()) is not None:
            traces.learning[c.name] = curve
        for name, tables in parts.diagnostics.items():
            if (curve := _middle(parts.few, tables)) is not None:
                traces.diagnostics.setdefault(name, {})[c.name] = curve
        if parts.heights:
            traces.heights[c.name] = _joined(parts.heights)
        if parts.evaluations and parts.scores:
            x = parts.at.astype(np.float64)
            training, greedy = (
                Curve(x, np.concatenate(tables, axis=1).mean(axis=1))
                for tables in (parts.scores, parts.evaluations)
            )
            traces.evaluations[c.name] = training, greedy
    return traces


class _Parts:
    """The records of one configuration's jobs, one table [k, n_trials] per job.

    ``end`` is the last iteration of the group, ``window`` the episodes of the running score.
    """

    def __init__(self, end: int, window: int) -> None:
        self.window, self.at, self.few = window, _grid(end, POINTS), _grid(end, FEWER_POINTS)
        self.scores: list[NDArray[np.float64]] = []
        self.means: list[NDArray[np.float64]] = []
        self.weights: list[int] = []
        self.diagnostics: dict[str, list[NDArray[np.float64]]] = {}
        self.evaluations: list[NDArray[np.float64]] = []
        self.heights: list[Heights] = []
        self.gaps: list[Gap] = []

    def read(self, job: Job) -> None:
        """Add the records of a job."""
        try:
            episodes = read_episodes(job.folder)
        except ResultsError as error:
            if (job.folder / EPISODES).exists():
                self.gaps.append(gap(job.folder, error))
            if (mean := _mean(job, self.at)) is not None:
                self.means.append(mean)
                self.weights.append(len(job.outcomes))
            return
        self.scores.append(running_means(*_columns(episodes, "score"), self.window, self.at))
        try:
            self._details(job, episodes)
        except ResultsError as error:
            self.gaps.append(gap(job.folder, error))

    def _details(self, job: Job, episodes: pd.DataFrame) -> None:
        rows = read_diagnostics(job.folder, episodes)
        if rows is not None:
            for name in DIAGNOSTICS:
                table = running_means(*_columns(rows, name), SMOOTH, self.few)
                self.diagnostics.setdefault(name, []).append(table)
        played = read_evaluations(job.folder)
        if played is not None and len(played["trial"]):
            # The episodes of one evaluation have the same iteration.
            count = int(np.unique(played["trial"] * 2**32 + played["iteration"],
                                  return_counts=True)[1].max())  # fmt: skip
            self.evaluations.append(
                running_means(played["trial"], played["iteration"], played["score"], count, self.at)
            )
            if (found := _heights(job, played, _columns(episodes, "score"))) is not None:
                self.heights.append(found)

    def visits(self, job: Job) -> dict[str, NDArray[np.int64]] | None:
        """Where the trials of a job have been; None if that was not recorded."""
        try:
            return read_visits(job.folder)
        except ResultsError as error:
            self.gaps.append(gap(job.folder, error))
            return None

    def learning(self) -> Curve | None:
        """The learning curve, with a band if every job recorded its episodes."""
        x = self.at.astype(np.float64)
        if self.scores and not self.means:
            table = np.concatenate(self.scores, axis=1)
            low, high = np.quantile(table, [0.25, 0.75], axis=1)
            return Curve(x, table.mean(axis=1), low, high)
        if self.means:
            parts = [*self.means, *(s.mean(axis=1) for s in self.scores)]
            sizes = [*self.weights, *(s.shape[1] for s in self.scores)]
            return Curve(x, np.average(parts, axis=0, weights=sizes))
        return None


def _heights(
    job: Job,
    played: Mapping[str, NDArray[Any]],
    trained: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]],
) -> Heights | None:
    """The heights of a job's curves; None unless every trial has the evaluations they need."""
    trial, iteration, score = played["trial"], played["iteration"], played["score"]
    names, learned = curve_means(trial, iteration, score, job.outcomes.cap)
    behaved = same_weights((trial, iteration), trained)
    both = np.isfinite(behaved)
    seeds = dict(zip(job.outcomes.trial.tolist(), job.outcomes.seed.tolist(), strict=True))
    of, evaluated = curve_means(trial[both], iteration[both], score[both])
    if len(names) < len(seeds) or len(of) < len(names):
        return None
    means = curve_means(trial[both], iteration[both], behaved[both])[1]
    return Heights([(seeds[t], t) for t in names.tolist()], learned, evaluated, means)


def _joined(parts: Sequence[Heights]) -> Heights:
    """The heights of several jobs."""
    keys = [key for part in parts for key in part.keys]
    arrays = ("learned", "evaluated", "behaved")
    return Heights(keys, *(np.concatenate([getattr(p, a) for p in parts]) for a in arrays))


def _middle(at: NDArray[np.int64], tables: Sequence[NDArray[np.float64]]) -> Curve | None:
    """Median and middle half over the trials that have a value; None if none has."""
    table = np.concatenate(list(tables), axis=1)
    known = np.isfinite(table).any(axis=1)
    if not known.any():
        return None
    low, middle, high = np.nanquantile(table[known], [0.25, 0.5, 0.75], axis=1)
    return Curve(at[known].astype(np.float64), middle, low, high)


def _columns(
    frame: pd.DataFrame, name: str
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    return (
        frame["trial"].to_numpy(np.int64),
        frame["iteration"].to_numpy(np.int64),
        frame[name].to_numpy(np.float64),
    )


def _grid(end: int, points: int) -> NDArray[np.int64]:
    return np.unique(np.linspace(1, end, points).round().astype(np.int64))


def _mean(job: Job, at: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """The mean score of a job without ``episodes.csv``; None if it was not recorded."""
    try:
        curve = read_curves(job.folder)["score"].dropna().to_numpy(np.float64)
    except (ValueError, KeyError, OSError):
        return None
    return curve[np.minimum(at, len(curve)) - 1] if len(curve) else None
