"""The contract of every collector: whole episodes of every active trial."""

from __future__ import annotations

from abc import abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.nn import TensorDictSequential
from torchrl.collectors import BaseCollector
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType

from trl_explore.checks import check_integer
from trl_explore.envs import LaneVectorEnv, lane_env
from trl_explore.envs.checking import check_resumable
from trl_explore.numerics.surrogate import FrameArrays
from trl_explore.policies.layers import spec_env
from trl_explore.strategies import BaseStrategy


class Rollout:
    """The episodes that one call of a collector returns: ``frames, score, length = rollout``.

    Args:
        frames: all frames, flat [frames], or a function that builds them; see
            ``EpisodeCollector`` for the entries.
        score: the undiscounted return of every episode [active], in ascending order of trials;
            [active, k] if every trial has k > 1 episodes. It is the sum of the environment's
            rewards in double precision.
        length: the number of frames of every episode, in the same shape.
        arrays: the entries that REINFORCE reads, if the collector keeps them as arrays. They are
            None as soon as the frames have been built, because their reader may change them.
    """

    def __init__(
        self,
        frames: TensorDictBase | Callable[[], TensorDictBase],
        score: NDArray[np.float64],
        length: NDArray[np.int64],
        arrays: FrameArrays | None = None,
    ) -> None:
        self._frames = frames
        self.score, self.length, self.arrays = score, length, arrays

    @property
    def frames(self) -> TensorDictBase:
        """All frames, flat [frames]."""
        if not isinstance(self._frames, TensorDictBase):
            self._frames, self.arrays = self._frames(), None
        return self._frames

    @property
    def count(self) -> int:
        """The number of frames."""
        return int(self.length.sum()) if self.arrays is None else len(self.arrays.trial)

    def __len__(self) -> int:
        return 3

    def __getitem__(self, index: int) -> Any:
        return tuple(self)[index]

    def __iter__(self) -> Iterator[Any]:
        return iter((self.frames, self.score, self.length))


class EpisodeCollector(BaseCollector):
    """A TorchRL collector that yields whole episodes of every active trial: one each by default.

    All frames of a trial are taken with the parameters that it had when the call began. No frame is
    lost or stale, none comes from a stopped trial, and none is padding. The data are flat [frames]:
    trials in ascending order, the frames of a trial contiguous and in order of time, each
    episode ended by ("next", "done"). The entries:

        trial              [frames]               int64, the row of the policy's parameters
        observation        [frames, n_features]   the policy's input
        action             [frames]               int64; [frames, n_dims] where continuous
        action_log_prob    [frames]               nats, under μ, if known exactly
        next.reward        [frames, 1]            float32
        next.done, next.terminated, next.truncated  [frames, 1]  bool
        next.step_count    [frames, 1]            int64, from 1
        next.episode_reward [frames, 1]           float32, ``RewardSum``: the sum so far

    and "action_mask" if the environment has one. As with TorchRL's ``compact_obs``, the next
    observation is not stored twice.

    Args:
        env: an environment made by ``envs.make_env``; its lanes are the trials.
        policy: ``TensorDictSequential(policy, strategy)``.

    Keyword Args:
        exploration_type: RANDOM or None explores; any other takes the argmax, or the mean.
        total_frames: iteration ends after this many frames; −1: never.
        episodes_per_update: the number of episodes of every active trial per call.

    Raises:
        ValueError: if an argument is out of range, or the strategy does not support the
            environment's kind of actions.

    Example:
        >>> from tensordict.nn import TensorDictSequential
        >>> from trl_explore.collectors import TorchRLCollector
        >>> from trl_explore.envs import make_env
        >>> from trl_explore.policies import LinearPolicy
        >>> from trl_explore.strategies import EpsilonGreedy
        >>> env = make_env("CartPole-v1", trials=3)
        >>> policy = TensorDictSequential(LinearPolicy(env), EpsilonGreedy(0.3))
        >>> collector = TorchRLCollector(env, policy)
        >>> rollout = collector.collect()
        >>> len(rollout.frames) == int(rollout.length.sum())
        True
    """

    parallel: ClassVar[bool] = False
    """Whether collectors in several threads run at the same time."""

    def __init__(
        self,
        env: TransformedEnv,
        policy: TensorDictSequential,
        *,
        exploration_type: ExplorationType | None = None,
        total_frames: int = -1,
        episodes_per_update: int = 1,
    ) -> None:
        super().__init__()
        self.closed = True
        self.env = env
        self.policy = policy
        self.lanes: LaneVectorEnv = lane_env(env)
        self.exploration_type = exploration_type or ExplorationType.RANDOM
        self.total_frames = total_frames
        self.episodes_per_update = check_integer("episodes_per_update", episodes_per_update, 1)
        lanes = self.lanes
        if not isinstance(strategy := policy[-1], BaseStrategy):
            raise ValueError(
                "the collector's policy must be TensorDictSequential(policy, strategy); "
                f"its last module is a {type(strategy).__name__}"
            )
        self.strategy = strategy
        self.strategy.set_spec(spec_env(env).action_spec)
        self.strategy.bind(
            policy[0], lanes.num_envs, seed=lanes.seed, first_trial=lanes.first_trial
        )
        self.frames = 0
        self.episodes = np.zeros(self.lanes.num_envs, dtype=np.int64)
        self.closed = False

    @property
    def trials(self) -> int:
        """The number of trials."""
        return self.lanes.num_envs

    def collect(self, active: NDArray[np.bool_] | None = None) -> Rollout:
        """The next ``episodes_per_update`` whole episodes of every active trial.

        Args:
            active: [trials] bool, the trials to collect; None means all.

        Returns:
            The frames and the outcome of each episode. The frames are valid until the next call,
            which may reuse their memory.

        Raises:
            ValueError: if ``active`` has the wrong shape or no true entry.
            RuntimeError: if the collector has been shut down.
        """
        if self.closed:
            raise RuntimeError("the collector has been shut down")
        if active is None:
            active = np.ones(self.trials, dtype=np.bool_)
        active = np.asarray(active, dtype=np.bool_)
        if active.shape != (self.trials,) or not np.count_nonzero(active):
            raise ValueError(
                f"active must be bool [{self.trials}] with at least one true entry, got {active!r}"
            )
        rollout = self._collect(active)
        self.episodes += active * self.episodes_per_update
        self.frames += rollout.count
        if self.episodes_per_update > 1:
            shape = (-1, self.episodes_per_update)
            rollout.score, rollout.length = (
                rollout.score.reshape(shape), rollout.length.reshape(shape),
            )  # fmt: skip
        return rollout

    @abstractmethod
    def _collect(self, active: NDArray[np.bool_]) -> Rollout:
        """The episodes of every active trial k, from ``self.episodes[k]`` on; flat outcomes."""

    def play(
        self, trials: NDArray[np.int64], episodes: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Play chosen episodes and keep only their outcomes; the counters do not change.

        Args:
            trials: the trial of each episode [m], in any order.
            episodes: its number [m]: trial and number determine the episode.

        Returns:
            The undiscounted return [m] and the number of frames [m] of each.

        Raises:
            RuntimeError: if the collector has been shut down.
        """
        if self.closed:
            raise RuntimeError("the collector has been shut down")
        trials, episodes = (np.asarray(x, dtype=np.int64) for x in (trials, episodes))
        if trials.ndim != 1 or trials.shape != episodes.shape:
            raise ValueError(
                f"trials {trials.shape} and episodes {episodes.shape}: both must be [m]"
            )
        if len(trials) and not 0 <= trials.min() <= trials.max() < self.trials:
            raise ValueError(f"trials must be from 0 to {self.trials - 1}")
        return self._play(trials, episodes)

    def _play(
        self, trials: NDArray[np.int64], episodes: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Collect the episodes in rounds with at most one per trial, and drop the frames."""
        score, length = np.empty(len(trials)), np.empty(len(trials), dtype=np.int64)
        counters, per_update = self.episodes.copy(), self.episodes_per_update
        todo, self.episodes_per_update = np.arange(len(trials)), 1
        try:
            while len(todo):
                _, first = np.unique(trials[todo], return_index=True)
                rows, active = todo[first], np.zeros(self.trials, dtype=np.bool_)
                active[trials[rows]] = True
                self.episodes[trials[rows]] = episodes[rows]
                _, score[rows], length[rows] = self._collect(active)
                todo = np.delete(todo, first)
        finally:
            self.episodes[:], self.episodes_per_update = counters, per_update
        return score, length

    def iterator(self) -> Iterator[TensorDictBase]:
        """Yield copies of the frames until ``total_frames`` is reached, or forever."""
        while self.total_frames < 0 or self.frames < self.total_frames:
            yield self.collect().frames.clone()

    def __len__(self) -> int:
        raise TypeError("a collector has no length: episodes differ in their number of frames")

    def set_seed(self, seed: int, static_seed: bool = False) -> int:
        """Restart every trial at episode 0 with ``seed``; returns the next seed to use."""
        self.lanes.reseed(seed)
        self.episodes[:] = 0
        self.frames = 0
        return seed if static_seed else seed + 1

    def state_dict(self) -> OrderedDict[str, Any]:
        """Everything that determines the next episodes: policy, strategy, seed and counters."""
        return OrderedDict(
            policy_state_dict=self.policy.state_dict(),
            seed=self.lanes.seed,
            episodes=torch.from_numpy(self.episodes.copy()),
            frames=self.frames,
        )

    def load_state_dict(self, state_dict: OrderedDict[str, Any]) -> None:
        """Restore a ``state_dict``.

        Raises:
            ValueError: if the environment keeps state that it does not hold.
        """
        if state_dict["frames"]:
            self._check_resumable()
        self.policy.load_state_dict(state_dict["policy_state_dict"])
        self.lanes.reseed(state_dict["seed"])
        self.episodes[:] = state_dict["episodes"].numpy()
        self.frames = state_dict["frames"]

    def shutdown(
        self, timeout: float | None = None, close_env: bool = True, raise_on_error: bool = True
    ) -> None:
        """Close the environment and free the memory for frames."""
        if not self.closed:
            self.closed = True
            self._free()
            if close_env and not self.env.is_closed:
                self.env.close(raise_if_closed=raise_on_error)

    def _check_resumable(self) -> None:
        check_resumable(self.lanes)

    def _free(self) -> None:
        """Free the memory for frames."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}(env={self.lanes.id}, trials={self.trials})"
