"""The record of every trial: scores, stopping rule, status."""

# numba rewrites signatures:
# pyright: reportCallIssue=false

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trl_explore.checks import check_integer, check_number
from trl_explore.numerics.compiled import arrays
from trl_explore.numerics.compiled.arrays import borrow
from trl_explore.numerics.compiled.cache import compiled
from trl_explore.training.ragged import flatten, unflatten

STATUSES = np.array(["active", "converged", "capped", "diverged"])
ACTIVE, CONVERGED, CAPPED, DIVERGED = range(4)
STOP_ON = ("training", "learned", "both", "never")
CURVES = ("episode_score", "score", "active", "converged")
_RESULTS = ("_status", "iterations", "frames", "seconds", "score", "passed", "_passed_at")
_STATE = (*_RESULTS, "_episode_score", "_window", "_sum")
"""The arrays that a checkpoint keeps; the last dimension of each is that of the trials."""
_COLUMNS = ("trial", "score", "frames")
_Episodes = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]
"""Trial [active], score and frames [active] or [active, k] of an iteration's episodes."""


class Trials:
    """The record of n independent trials, and their stopping rule.

    A trial has passed when the mean score of its last ``score_window`` episodes is greater than
    ``score_threshold``, over a full window. What stops it, so that it has converged, is that it has
    passed, or learned, or both, by ``stop_on``. It is capped (right-censored) after
    ``max_iterations``; it has diverged when its loss or a weight is no longer finite.

    Args:
        trials: n >= 1.
        max_iterations: the cap, >= 1.
        score_threshold: the final score must exceed it.
        score_window: the number of episodes that the final score averages over, >= 1.
        stop_on: what stops a trial before the cap: ``training`` (it has passed), ``learned``,
            ``both``, or ``never``.

    Raises:
        ValueError: if an argument is out of range.
    """

    def __init__(
        self,
        trials: int,
        *,
        max_iterations: int = 1000,
        score_threshold: float = 195.0,
        score_window: int = 100,
        stop_on: str = "training",
    ) -> None:
        if stop_on not in STOP_ON:
            raise ValueError(f"stop_on must be one of {', '.join(STOP_ON)}, got {stop_on!r}")
        self.stop_on = stop_on
        n = check_integer("trials", trials, 1)
        self.max_iterations = check_integer("max_iterations", max_iterations, 1)
        self.score_threshold = check_number("score_threshold", score_threshold)
        self.score_window = check_integer("score_window", score_window, 1)
        self._status = np.full(n, ACTIVE, dtype=np.uint8)
        self.active = np.ones(n, dtype=np.bool_)
        self.iterations = np.zeros(n, dtype=np.int64)
        self.frames = np.zeros(n, dtype=np.int64)
        self.seconds = np.zeros(n)
        self.score = np.zeros(n)
        """Mean score of the last ``score_window`` episodes, or of all if there are fewer [n]."""
        self.passed = np.zeros(n, dtype=np.bool_)
        """Whether the trial has passed, now or in an earlier iteration [n]."""
        self._passed_at = np.zeros((2, n), dtype=np.int64)
        """Iterations and frames until then [2, n]."""
        self._episode_score = np.zeros(n)
        self._n_episodes = 0
        self._window = np.zeros((self.score_window, n))
        self._sum = np.zeros(n)
        """Sum of the scores in the window; empty places count 0 [n]."""
        self._episodes: list[_Episodes] = []

    @classmethod
    def joined(cls, parts: Sequence[Trials]) -> Trials:
        """One record of the trials of all parts, in order; it cannot record more iterations."""
        first, *others = parts
        if not others:
            return first
        out = cls(
            sum(map(len, parts)),
            max_iterations=first.max_iterations,
            score_threshold=first.score_threshold,
            score_window=first.score_window,
            stop_on=first.stop_on,
        )
        for name in (*_RESULTS, "active"):
            setattr(out, name, np.concatenate([getattr(part, name) for part in parts], axis=-1))
        offsets = np.cumsum([0, *map(len, parts)])
        for i in range(max(part.iteration for part in parts)):
            rows = [
                (trial + offset, *cells)
                for part, offset in zip(parts, offsets.tolist(), strict=False)
                for trial, *cells in part._episodes[i : i + 1]
            ]
            out._episodes.append(
                cast(_Episodes, tuple(map(np.concatenate, zip(*rows, strict=True))))
            )
        return out

    def __len__(self) -> int:
        return len(self._status)

    @property
    def iteration(self) -> int:
        """The number of iterations recorded so far."""
        return len(self._episodes)

    def record(
        self,
        scores: NDArray[np.float64],
        frames: NDArray[np.int64],
        diverged: NDArray[np.bool_],
        seconds: float,
        learned: NDArray[np.bool_] | None = None,
    ) -> None:
        """Record one iteration, and apply the stopping rule.

        Args:
            scores: undiscounted returns of the episodes of the active trials, in ascending order
                of trials [active], or [active, k] with k episodes each.
            frames: the numbers of frames of the episodes, in the same shape.
            diverged: whether the trial's loss or a weight is not finite [active].
            seconds: wall time since the first iteration of these trials began [s].
            learned: whether each trial has learned [n]; needed if that can stop it.
        """
        (trial,) = self.active.nonzero()
        highest = self._enter((trial, scores, frames), seconds)
        full = self._n_episodes >= self.score_window
        if full and highest > self.score_threshold:
            new = trial[(self.score[trial] > self.score_threshold) & ~diverged]
            new = new[~self.passed[new]]
            self.passed[new] = True
            self._passed_at[:, new] = self.iterations[new], self.frames[new]
        met = self._met(trial, learned)
        if (
            np.count_nonzero(met)
            or np.count_nonzero(diverged)
            or self.iteration >= self.max_iterations
        ):
            self._stop(trial, met, diverged)

    def _met(
        self, trial: NDArray[np.int64], learned: NDArray[np.bool_] | None
    ) -> NDArray[np.bool_]:
        """Whether the stopping rule is met, before the cap [active]."""
        if self.stop_on == "training":
            return self.passed[trial]
        if self.stop_on == "never":
            return np.zeros(len(trial), dtype=np.bool_)
        if learned is None:
            raise ValueError(f"stop_on={self.stop_on} needs to know which trials have learned")
        return learned[trial] if self.stop_on == "learned" else (learned & self.passed)[trial]

    def _enter(self, episodes: _Episodes, seconds: float) -> float:
        """Record the episodes of an iteration; returns the highest final score of their trials.

        It costs nothing here, and usually shows that no trial can have passed.
        """
        self._episodes.append(episodes)
        trial, scores, frames = episodes
        columns = scores.reshape(len(trial), -1)
        first = self._n_episodes % self.score_window
        self._n_episodes += columns.shape[1]
        return _enter_rows(
            trial, columns, frames.reshape(columns.shape), first,
            min(self._n_episodes, self.score_window), seconds, self.iterations, self.frames,
            self.seconds, self.score, self._episode_score, self._window, self._sum,
        )  # fmt: skip

    def _stop(
        self, trial: NDArray[np.int64], met: NDArray[np.bool_], diverged: NDArray[np.bool_]
    ) -> None:
        self._status[trial[met]] = CONVERGED
        self._status[trial[diverged]] = DIVERGED
        if self.iteration >= self.max_iterations:
            self._status[self._status == ACTIVE] = CAPPED
        self.active = self._status == ACTIVE

    @property
    def status(self) -> NDArray[np.str_]:
        """The status of each trial: active, converged, capped or diverged [n]."""
        return STATUSES[self._status]

    @property
    def iterations_to_pass(self) -> NDArray[np.int64]:
        """Iterations until the trial passed, or all so far [n]."""
        return np.where(self.passed, self._passed_at[0], self.iterations)

    @property
    def frames_to_pass(self) -> NDArray[np.int64]:
        """Frames until the trial passed, or all so far [n]."""
        return np.where(self.passed, self._passed_at[1], self.frames)

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Whether the trial's stopping rule was met [n]."""
        return self._status == CONVERGED

    def curves(self) -> dict[str, NDArray[np.float64]]:
        """Averages over all trials after every iteration, each [iterations].

        Up to and including its last iteration a trial counts with the score of its episode,
        afterwards with its final score.
        """
        again, n = Trials(len(self), score_window=self.score_window), len(self)
        stopped = ~self.active
        ends, converged = (
            np.bincount(self.iterations[which], minlength=self.iteration + 1)[1:]
            for which in (stopped, self.converged)
        )
        averages = np.empty((2, self.iteration))
        for i, episodes in enumerate(self._episodes):
            trial = episodes[0]
            again._enter(episodes, 0.0)
            averages[:, i] = np.add.reduce(again._episode_score), np.add.reduce(again.score)
            if ends[i]:
                last = trial[(self.iterations[trial] == i + 1) & stopped[trial]]
                again._episode_score[last] = again.score[last]
        counts = np.stack([n - ends.cumsum(), converged.cumsum()]).astype(np.float64)
        return dict(zip(CURVES, [*averages / n, *counts], strict=True))

    def episodes(self) -> dict[str, NDArray[np.float64] | NDArray[np.int64]]:
        """One row per episode, ordered by iteration and then trial."""
        trials, scores, all_frames = zip(*self._episodes, strict=True)
        score = np.concatenate([column.reshape(-1) for column in scores])
        frames = np.concatenate([column.reshape(-1) for column in all_frames])
        sizes = [column.size for column in scores]
        repeats = [column.size // len(t) for t, column in zip(trials, scores, strict=True)]
        trial = np.concatenate([np.repeat(t, k) for t, k in zip(trials, repeats, strict=True)])
        iteration = np.repeat(np.arange(1, len(sizes) + 1), sizes)
        return {"trial": trial, "iteration": iteration, "score": score, "frames": frames}

    def state_dict(self) -> dict[str, Any]:
        """The state without the episodes, which ``history`` has; its size is constant."""
        arrays = {name: getattr(self, name).copy() for name in _STATE}
        return {**arrays, "iteration": self.iteration, "episodes": self._n_episodes}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a ``state_dict``; load its history first.

        Raises:
            ValueError: if history and state differ in their number of iterations.
        """
        if state["iteration"] != self.iteration:
            raise ValueError(
                f"the state has {state['iteration']} iterations, "
                f"but the history has {self.iteration}"
            )
        for name in _STATE:
            getattr(self, name)[:] = state[name]
        self.active = self._status == ACTIVE
        self._n_episodes = int(state["episodes"])

    def history(self, since: int = 0, until: int | None = None) -> dict[str, NDArray[Any]]:
        """Iterations ``since`` + 1 to ``until`` as columns; None means the last."""
        return flatten(self._episodes[since:until], _COLUMNS)

    def load_history(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Append the output of ``history``."""
        self._episodes += cast(Any, unflatten(columns, _COLUMNS))


@compiled(arrays)
def _enter_rows(
    trial, scores, counts, first, filled, now, iterations, frames, seconds, score, episode_score,
    window, window_sum,
):  # fmt: skip
    """Record an iteration's episodes [active, k]; returns the highest final score."""
    size, highest = len(window), -np.inf
    window = borrow(window)
    for j in range(len(trial)):
        row, total, steps = trial[j], 0.0, 0
        for e in range(scores.shape[1]):
            place = (first + e) % size
            window_sum[row] += scores[j, e] - window[place, row]  # exact for whole numbers
            window[place, row] = scores[j, e]
            if place == size - 1:  # so that rounding errors do not accumulate
                window_sum[row] = 0.0
                for f in range(size):
                    window_sum[row] += window[f, row]
            total += scores[j, e]
            steps += counts[j, e]
        iterations[row] += 1
        frames[row] += steps
        seconds[row] = now
        episode_score[row] = total / scores.shape[1]
        score[row] = window_sum[row] / filled
        if score[row] > highest:
            highest = score[row]
    return highest
