"""Evaluation of the greedy policy, with random streams separate from those of training."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.checks import check_integer
from trl_explore.collectors import EpisodeCollector
from trl_explore.strategies import (
    Argmax,
    BaseStrategy,
    ContinuousStrategy,
    MeanAction,
    Strategy,
)


class Evaluator:
    """Scores of the greedy policy argmax π(·|s) of every trial, every ``every`` iterations.

    The score of a training episode includes the effect of exploration: ε = 0.3 lowers the score.
    Here every active trial plays ``episodes`` episodes without exploration, with the streams
    ``Stream.EVALUATION``, so that evaluation does not change the random numbers or the files of
    training.

    Args:
        collector: a collector with a separate environment, ``ExplorationType.DETERMINISTIC`` and
            ``episodes`` episodes per call.
        every: the number of iterations between evaluations, >= 1.
        score_window: the number of evaluation episodes that the mean averages over, >= 1.
        score_threshold: the mean over a full window must exceed it.

    Raises:
        ValueError: if a number is out of range.
    """

    def __init__(
        self, collector: EpisodeCollector, *, every: int, score_window: int, score_threshold: float
    ) -> None:
        self.collector = collector
        self.every = check_integer("evaluate_every", every, 1)
        self.score_threshold = score_threshold
        self._window = np.zeros((collector.trials, check_integer("score_window", score_window, 1)))
        self._filled = 0
        self._rows: list[tuple[int, NDArray[np.int64], NDArray[np.float64]]] = []

    def is_due(self, iteration: int) -> bool:
        """Whether there is an evaluation after ``iteration`` iterations."""
        return iteration % self.every == 0

    def evaluate(self, iteration: int, active: NDArray[np.bool_]) -> None:
        """Play episodes with the active trials' current parameters, and record the scores."""
        k = self.collector.episodes_per_update
        # Episode numbers follow from the iteration, so they do not depend on when trials stopped.
        self.collector.episodes[:] = k * (iteration // self.every - 1)
        scores = self.collector.collect(active).score
        trial, columns = np.flatnonzero(active), scores.reshape(-1, k)
        for j in range(k):
            self._window[trial, (self._filled + j) % self._window.shape[1]] = columns[:, j]
        self._filled += k
        self._rows.append((iteration, trial, columns))

    def passed(self, active: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Whether the mean over a full window exceeds the threshold [active]."""
        full = self._filled >= self._window.shape[1]
        return full & (self._window[active].mean(1) > self.score_threshold)

    def rows(self) -> dict[str, NDArray[Any]]:
        """One row for each evaluation episode: "trial", "iteration", "score"."""
        k = self.collector.episodes_per_update
        trial = [np.repeat(lanes, k) for _, lanes, _ in self._rows]
        iteration = [np.repeat(i, columns.size) for i, _, columns in self._rows]
        score = [columns.reshape(-1) for _, _, columns in self._rows]
        return {
            "trial": np.concatenate([np.empty(0, np.int64), *trial]),
            "iteration": np.concatenate([np.empty(0, np.int64), *iteration]),
            "score": np.concatenate([np.empty(0), *score]),
        }

    def state_dict(self) -> dict[str, Any]:
        """The window of scores that ``passed`` reads; ``history`` has all scores."""
        return {"window": self._window.copy(), "filled": self._filled}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a ``state_dict``."""
        self._window[:] = np.asarray(state["window"])
        self._filled = int(state["filled"])

    def history(self, since: int = 0, until: int | None = None) -> dict[str, NDArray[Any]]:
        """The record of the iterations after the first ``since``, up to and with ``until``."""
        last = math.inf if until is None else until
        part = [row for row in self._rows[since // self.every :] if since < row[0] <= last]
        k = self.collector.episodes_per_update
        return {
            "iterations": np.array([iteration for iteration, _, _ in part], dtype=np.int64),
            "counts": np.array([len(trial) for _, trial, _ in part], dtype=np.int64),
            "trial": np.concatenate([np.empty(0, np.int64), *(trial for _, trial, _ in part)]),
            "scores": np.concatenate([np.empty((0, k)), *(columns for _, _, columns in part)]),
        }

    def load_history(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Append the output of ``history``."""
        cuts = np.cumsum(columns["counts"])[:-1]
        parts = (columns["iterations"].tolist(), *(
            np.split(columns[name], cuts) for name in ("trial", "scores")
        ))  # fmt: skip
        if len(columns["counts"]):
            self._rows += list(zip(*parts, strict=True))


def exploiting(strategy: BaseStrategy) -> BaseStrategy:
    """The strategy that takes the greedy action, with the same keys as ``strategy``.

    For discrete actions it is the argmax of the logits; for continuous ones, the mean.

    Raises:
        TypeError: if the strategy is of neither kind.
    """
    if isinstance(strategy, Strategy):
        return Argmax(
            spec=strategy.spec,
            logits_key=strategy.logits_key,
            action_key=strategy.action_key,
            action_mask_key=strategy.action_mask_key,
        )
    if isinstance(strategy, ContinuousStrategy):
        return MeanAction(
            loc_key=strategy.loc_key, scale_key=strategy.scale_key, action_key=strategy.action_key
        )
    raise TypeError(f"{type(strategy).__name__} must be a Strategy or a ContinuousStrategy")
