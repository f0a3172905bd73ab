"""What the policy has learned: its score without the strategy, on random streams of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.checks import check_integer
from trl_explore.collectors import EpisodeCollector
from trl_explore.statistics.evaluations import (
    AUTO,
    FINAL_EPISODES,
    LEARNED,
    UNDECIDED,
    decide,
    schedule,
    stages,
)
from trl_explore.strategies import (
    Argmax,
    BaseStrategy,
    ContinuousStrategy,
    Gaussian,
    MeanAction,
    Softmax,
    Strategy,
)
from trl_explore.training.ragged import flatten, unflatten

SCHEDULED, CONFIRMATION, FINAL = range(3)
"""Indices into ``statistics.evaluations.PURPOSES``."""
_STATE = (
    "learned", "iterations_to_learn", "frames_to_learn", "learned_score", "_lowest", "_latest",
    "_looked",
)  # fmt: skip
"""The arrays that a checkpoint keeps; each has an entry per trial."""

_Row = tuple[NDArray[np.int64], int, NDArray[np.int64], NDArray[np.float64]]
"""Iteration [trials], purpose, trial [trials], and scores [trials, episodes] of some episodes."""


class Evaluator:
    """Plays the policy of every trial without exploration, and decides when it has learned.

    The score of a training episode includes the effect of exploration: ε = 0.3 lowers the score.
    Here the policy acts alone. An evaluation at iteration i plays the weights after i updates. The
    training episode of iteration i + 1 is played with the same weights: the difference of the two
    is what exploration costs the agent while it acts.

    Scheduled evaluations play ``episodes`` episodes of every active trial. If their mean exceeds
    the threshold and the trial has not learned yet, fresh episodes must confirm it
    (``statistics.evaluations.decide``). At the end, ``FINAL_EPISODES`` episodes of every trial's
    final policy give its learned score; if it has not learned and no evaluation was due when it
    stopped, they are its last evaluation.
    Iteration 0 is evaluated, but cannot show that a trial has learned.

    Every episode has its own stream, from seed, trial, purpose, iteration and its index, so that no
    score depends on other evaluations, and training draws the same numbers with or without them.

    Args:
        collector: a collector with a separate random stream and a strategy that does not explore.
        every: the iterations between evaluations, >= 1, or ``auto``.
        episodes: the episodes of a scheduled evaluation, >= 1.
        most: the largest number of confirmation episodes, >= 20.
        threshold: the mean score must exceed it.
        max_iterations: the cap of the trials, which is always evaluated.

    Raises:
        ValueError: if a number is out of range.
    """

    def __init__(
        self,
        collector: EpisodeCollector,
        *,
        every: int | str = AUTO,
        episodes: int = 1,
        most: int = 500,
        threshold: float,
        max_iterations: int,
    ) -> None:
        self.collector = collector
        self.every = every if every == AUTO else check_integer("evaluate_every", every, 1)
        self.episodes = check_integer("evaluate_episodes", episodes, 1, 10**6)
        self.most = check_integer("evaluate_confirm", most, 20, 10**6)
        self.threshold, self.max_iterations = threshold, max_iterations
        n = collector.trials
        self.learned = np.zeros(n, dtype=np.bool_)
        """Whether the trial has learned [n]."""
        self.iterations_to_learn = np.zeros(n, dtype=np.int64)
        """The iteration of the evaluation that showed it [n]; before, that of the latest."""
        self.frames_to_learn = np.zeros(n, dtype=np.int64)
        """The training frames until then [n]."""
        self.learned_score = np.zeros(n)
        """Mean score of the final policy [n]; of a diverged trial, that of its last evaluation."""
        self._lowest = np.full(n, math.inf)
        self._latest = np.zeros(n)
        self._looked = np.full(n, -1, dtype=np.int64)
        self._rows: list[_Row] = []
        self._last: list[_Row] = []
        """The rows of ``finish``, which a resumed training plays again."""
        fixed = schedule(self.every, max_iterations)
        self._fixed = None if fixed is None else frozenset(fixed.tolist())

    def is_due(self, iteration: int) -> bool:
        """Whether there is an evaluation after ``iteration`` iterations."""
        if self._fixed is not None:
            return iteration in self._fixed
        return iteration % int(self.every) == 0 or iteration == self.max_iterations

    def evaluate(
        self, iteration: int, active: NDArray[np.bool_], frames: NDArray[np.int64]
    ) -> None:
        """Evaluate the active trials with their current parameters.

        Args:
            iteration: the number of updates so far.
            active: the trials to evaluate [n].
            frames: the training frames of every trial so far [n].
        """
        trials = np.flatnonzero(active & (self._looked < iteration))
        at = np.full(len(trials), iteration)
        scores = self._play(SCHEDULED, at, trials, 0, self.episodes, self._rows)
        self._judge(at, trials, scores, frames, self._rows)

    def finish(
        self,
        iterations: NDArray[np.int64],
        frames: NDArray[np.int64],
        diverged: NDArray[np.bool_],
    ) -> None:
        """Play the final policies, after all trials have stopped.

        Args:
            iterations: of every trial until it stopped [n].
            frames: the training frames of every trial [n].
            diverged: which trials have no usable policy any more [n].
        """
        self._last = []
        never = diverged & ~self.learned
        self.learned_score[diverged] = self._latest[diverged]
        self.iterations_to_learn[never], self.frames_to_learn[never] = (
            iterations[never], frames[never],
        )  # fmt: skip
        trials = np.flatnonzero(~diverged)
        at = iterations[trials]
        scores = self._play(FINAL, at, trials, 0, FINAL_EPISODES, self._last)
        self.learned_score[trials] = scores.mean(1)
        new = self._looked[trials] < at
        self._judge(at[new], trials[new], scores[new], frames, self._last)

    def _judge(
        self,
        at: NDArray[np.int64],
        trials: NDArray[np.int64],
        scores: NDArray[np.float64],
        frames: NDArray[np.int64],
        rows: list[_Row],
    ) -> None:
        """Apply the rule to an evaluation, with scores [trials, k], at the iterations [trials]."""
        mean = scores.mean(1)
        self._latest[trials], self._looked[trials] = mean, at
        late = ~self.learned[trials]
        self.iterations_to_learn[trials[late]] = at[late]
        self.frames_to_learn[trials[late]] = frames[trials[late]]
        todo = late & (mean > self.threshold) & (at > 0)
        trials, at = trials[todo], at[todo]
        known = np.empty((len(trials), 0))
        for n in stages(self.most):
            if not len(trials):
                break
            fresh = self._play(CONFIRMATION, at, trials, known.shape[1], n, rows)
            known = np.concatenate([known, fresh], axis=1)
            verdict = decide(known, self._lowest[trials], self.threshold, self.most)
            self.learned[trials[verdict == LEARNED]] = True
            todo = verdict == UNDECIDED
            trials, at, known = trials[todo], at[todo], known[todo]

    def _play(
        self,
        purpose: int,
        at: NDArray[np.int64],
        trials: NDArray[np.int64],
        first: int,
        until: int,
        rows: list[_Row],
    ) -> NDArray[np.float64]:
        """Play and record the episodes ``first`` to ``until`` of the trials [trials, episodes]."""
        numbers = episode_number(purpose, at[:, None], np.arange(first, until))
        k = until - first
        scores = self.collector.play(np.repeat(trials, k), numbers.reshape(-1))[0].reshape(-1, k)
        rows.append((at, purpose, trials, scores))
        self._lowest[trials] = np.minimum(self._lowest[trials], scores.min(1))
        return scores

    def rows(self) -> dict[str, NDArray[Any]]:
        """One row per episode: "trial", "iteration", "score", and "purpose" as an index.

        Ordered by iteration, purpose, trial and episode.
        """
        rows = [*self._rows, *self._last]
        iteration = np.concatenate([np.repeat(at, x.shape[1]) for at, _, _, x in rows])
        trial = np.concatenate([np.repeat(trials, x.shape[1]) for _, _, trials, x in rows])
        purpose = np.concatenate([np.full(x.size, kind) for _, kind, _, x in rows])
        score = np.concatenate([x.reshape(-1) for *_, x in rows])
        columns = {"trial": trial, "iteration": iteration, "score": score, "purpose": purpose}
        order = np.lexsort((trial, purpose, iteration))
        return {name: column[order] for name, column in columns.items()}

    def state_dict(self) -> dict[str, Any]:
        """What the rule has decided and needs to go on; ``history`` has all scores."""
        return {name: getattr(self, name).copy() for name in _STATE}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a ``state_dict``."""
        for name in _STATE:
            getattr(self, name)[:] = state[name]

    def history(self, since: int = 0, until: int | None = None) -> dict[str, NDArray[Any]]:
        """The episodes after the first ``since`` iterations, up to and with ``until``.

        Iteration 0 belongs to the first part. Every call of the collector gives one entry.
        """
        last = math.inf if until is None else until
        part = [
            row for row in self._rows if (since < row[0][0] or since == 0) and row[0][0] <= last
        ]
        return {
            "iterations": np.array([row[0][0] for row in part], dtype=np.int64),
            "purposes": np.array([row[1] for row in part], dtype=np.int64),
            **flatten([row[2:] for row in part], ("trial", "score")),
        }

    def load_history(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Append the output of ``history``."""
        kinds = (columns[name].tolist() for name in ("iterations", "purposes"))
        entries = unflatten(columns, ("trial", "score"))
        for iteration, purpose, (trials, scores) in zip(*kinds, entries, strict=True):
            at = np.full(len(trials), iteration)
            self._rows.append((at, purpose, trials, scores.reshape(len(trials), -1)))


def episode_number(purpose: int, iteration: Any, episode: Any) -> Any:
    """The number of an evaluation episode, from which its random streams follow.

    Training episodes have smaller numbers, so that no action noise is used twice.

    >>> episode_number(CONFIRMATION, 5, 3) == 2 * 2**52 + 5 * 2**21 + 3
    True
    """
    return (purpose + 1) * 2**52 + iteration * 2**21 + episode


def acting(strategy: BaseStrategy, policy: str) -> BaseStrategy:
    """The strategy that evaluations use in place of ``strategy``, with the same keys.

    Args:
        strategy: the strategy of the training.
        policy: ``greedy``: the argmax of the logits, or the mean of a Gaussian; ``sampled``: an
            action of π.

    Raises:
        TypeError: if the strategy is neither a ``Strategy`` nor a ``ContinuousStrategy``.
    """
    greedy = policy == "greedy"
    if isinstance(strategy, Strategy):
        return (Argmax if greedy else Softmax)(
            spec=strategy.spec,
            logits_key=strategy.logits_key,
            action_key=strategy.action_key,
            action_mask_key=strategy.action_mask_key,
        )
    if isinstance(strategy, ContinuousStrategy):
        return (MeanAction if greedy else Gaussian)(
            loc_key=strategy.loc_key, scale_key=strategy.scale_key, action_key=strategy.action_key
        )
    raise TypeError(f"{type(strategy).__name__} must be a Strategy or a ContinuousStrategy")
