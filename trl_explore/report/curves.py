"""Learning curves of a configuration, from its episodes or, without them, from its scalars."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from trl_explore.report.figures.learning import Row
from trl_explore.report.groups import Group
from trl_explore.report.loading import Gap, Job, gap
from trl_explore.results import EPISODES, ResultsError, read_curves, read_episodes

POINTS = 240
"""Most iterations at which a curve is drawn."""


def running_scores(
    episodes: pd.DataFrame, window: int, at: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Mean score over the last ``window`` episodes of every trial, at some iterations.

    A trial that has stopped carries its last value forward.

    Args:
        episodes: columns trial, iteration (from 1) and score.
        window: number of episodes; before so many exist, the mean is over those there are.
        at: iterations [k], from 1.

    Returns:
        [k, n_trials], trials in ascending order.

    """
    rows = episodes.sort_values(["trial", "iteration"], kind="stable")
    trial, place = np.unique(rows["trial"], return_inverse=True)
    starts = np.searchsorted(place, np.arange(len(trial) + 1))
    total = np.concatenate([[0.0], np.cumsum(rows["score"].to_numpy(np.float64))])
    iteration = rows["iteration"].to_numpy()
    result = np.empty((len(at), len(trial)))
    for k in range(len(trial)):
        first, last = starts[k], starts[k + 1]
        # One past the last episode with iteration ≤ at.
        end = first + np.searchsorted(iteration[first:last], at, side="right")
        end = np.maximum(end, first + 1)
        begin = np.maximum(first, end - window)
        result[:, k] = (total[end] - total[begin]) / (end - begin)
    return result


def learning_rows(group: Group) -> tuple[list[Row], list[Gap]]:
    """One learning curve per configuration that has one, and what could not be read."""
    end = max(int(c.iterations.max()) for c in group.configurations)
    at = np.unique(np.linspace(1, end, POINTS).round().astype(np.int64))
    rows, gaps = [], []
    for c in group.configurations:
        scores, means, weights = [], [], []
        for job in group.jobs[c.name]:
            try:
                scores.append(_scores(job, group.window, at))
            except ResultsError as error:
                if (job.folder / EPISODES).exists():
                    gaps.append(gap(job.folder, error))
                try:
                    means.append(_mean(job, at))
                    weights.append(len(job.outcomes))
                except ResultsError:
                    continue
        style, label = group.styles[c.name], group.labels[c.name]
        x = at.astype(np.float64)
        if scores and not means:
            table = np.concatenate(scores, axis=1)
            low, high = np.quantile(table, [0.25, 0.75], axis=1)
            rows.append(Row(label, x, table.mean(axis=1), low, high, style))
        elif means or scores:
            parts = [*means, *(s.mean(axis=1) for s in scores)]
            sizes = [*weights, *(s.shape[1] for s in scores)]
            rows.append(Row(label, x, np.average(parts, axis=0, weights=sizes), None, None, style))
    return rows, gaps


def _scores(job: Job, window: int, at: NDArray[np.int64]) -> NDArray[np.float64]:
    episodes = read_episodes(job.folder)
    if episodes["score"].dtype.kind not in "if":
        raise ResultsError(f"{job.folder / EPISODES}: column score is not of numbers")
    return running_scores(episodes, window, at)


def _mean(job: Job, at: NDArray[np.int64]) -> NDArray[np.float64]:
    try:
        curves = read_curves(job.folder)
        curve = curves["score"].dropna().to_numpy(np.float64)
    except (ValueError, KeyError, OSError) as error:
        raise ResultsError(f"{job.folder}: no learning curve ({error})") from None
    if not len(curve):
        raise ResultsError(f"{job.folder}: an empty learning curve")
    return curve[np.minimum(at, len(curve)) - 1]
