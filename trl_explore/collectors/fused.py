"""The collector that compiles what environment, policy and strategy say."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.wrappers import (
    DtypeObservation,
    FlattenObservation,
    OrderEnforcing,
    PassiveEnvChecker,
    TimeLimit,
)
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictSequential
from torchrl.envs import RewardSum, StepCounter, TransformedEnv
from torchrl.envs.utils import ExplorationType

from trl_explore.collectors.base import EpisodeCollector
from trl_explore.collectors.loop import compile_loop, scratch
from trl_explore.kernels import Kernel, kernel_of
from trl_explore.policy import LinearPolicy
from trl_explore.strategies import Mixture, MixtureStrategy
from trl_explore.streams import Stream, key

WRAPPERS = (TimeLimit, OrderEnforcing, PassiveEnvChecker, FlattenObservation, DtypeObservation)
TRANSFORMS = (StepCounter, RewardSum)

ROOT = ("trial", "observation", "action", "action_log_prob")
NEXT = ("reward", "done", "terminated", "truncated", "step_count", "episode_reward")


class NotCompilableError(ValueError):
    """What the fused collector was given and cannot compile; the message says why."""


class Columns:
    """Flat arrays for frames, kept from call to call, that grow when an episode might not fit."""

    def __init__(self, n_features: int) -> None:
        self.n_features = n_features
        self.capacity = 0
        self.arrays: tuple[NDArray[Any], ...] = ()

    def reserve(self, capacity: int, used: int = 0) -> None:
        """Make room for ``capacity`` frames; the first ``used`` are kept."""
        if capacity <= self.capacity:
            return
        shapes = (
            ((), np.int64),  # trial
            ((self.n_features,), np.float32),  # observation
            ((), np.int64),  # action
            ((), np.float32),  # action_log_prob
            ((), np.float32),  # reward
            ((), np.bool_),  # done
            ((), np.bool_),  # terminated
            ((), np.bool_),  # truncated
            ((), np.int64),  # step_count
            ((), np.float32),  # episode_reward
        )
        grown = tuple(np.empty((capacity, *shape), dtype) for shape, dtype in shapes)
        for new, old in zip(grown, self.arrays, strict=False):
            new[:used] = old[:used]
        self.capacity, self.arrays = capacity, grown
        self._root = dict(zip(ROOT, map(torch.from_numpy, grown[:4]), strict=True))
        after = (torch.from_numpy(array).unsqueeze(-1) for array in grown[4:])
        self._next = dict(zip(NEXT, after, strict=True))

    def frames(self, n: int) -> TensorDict:
        """The first n frames as a TensorDict over the same memory."""
        batch = torch.Size([n])
        source: dict[str, Any] = {name: column[:n] for name, column in self._root.items()}
        after = {name: column[:n] for name, column in self._next.items()}
        source["next"] = TensorDict._new_unsafe(after, batch)
        return TensorDict._new_unsafe(source, batch)


class FusedCollector(EpisodeCollector):
    """Runs whole episodes in machine code, thousands of times faster than stepping TorchRL.

    It compiles the environment's id and constants, the transforms it knows, the policy's weights
    and the strategy's mixture; the same seed gives the same episodes as the ``TorchRLCollector``,
    up to floating-point rounding. Arguments and data are those of ``EpisodeCollector``.

    Keyword Args:
        threads: the number of threads among which trials are divided; the data do not depend on it.

    Raises:
        NotCompilableError: with the reason, if the environment has no kernel, or a wrapper, transform,
            policy or strategy is not of a kind that the loop knows.
    """

    def __init__(
        self,
        env: TransformedEnv,
        policy: TensorDictSequential,
        *,
        exploration_type: ExplorationType = ExplorationType.RANDOM,
        total_frames: int = -1,
        threads: int = 1,
    ) -> None:
        super().__init__(env, policy, exploration_type=exploration_type, total_frames=total_frames)
        self.kernel = compilable(env, policy)
        self._loop = compile_loop(self.kernel)
        self._columns = Columns(self.kernel.n_features)
        self._scratch = scratch(self.kernel, int(self.lanes.max_steps))
        self._linear: LinearPolicy = policy[0]

    def _collect(self, active: NDArray[np.bool_]) -> TensorDictBase:
        lanes, columns = self.lanes, self._columns
        trials = np.flatnonzero(active)
        episodes = self.episodes[trials]
        weight = self._linear.weight.detach().numpy()
        mixture = self._mixture()
        keys = key(lanes.seed, Stream.ENVIRONMENT), key(lanes.seed, Stream.ACTION)
        finished = frames = 0
        columns.reserve(len(trials) * 64)
        while True:
            done, frames = self._loop(
                self.kernel.parameters, trials[finished:], episodes[finished:], lanes.first_trial,
                *keys, weight, mixture, self._scratch, columns.arrays, frames,
            )  # fmt: skip
            finished += done
            if finished == len(trials):
                return columns.frames(frames)
            columns.reserve(2 * columns.capacity, frames)

    def _mixture(self) -> NDArray[np.float64]:
        """Weights and temperature [4, 1], or [4, trials] where they differ between trials."""
        strategy = self.strategy
        assert isinstance(strategy, MixtureStrategy)
        explore = self.exploration_type == ExplorationType.RANDOM
        point = strategy.mixture() if explore else Mixture(greedy=1.0)
        if all(isinstance(value, float) for value in point):
            return np.array(point).reshape(4, 1)
        return np.stack(np.broadcast_arrays(*map(np.atleast_1d, point))).astype(np.float64)


def compilable(env: TransformedEnv, policy: TensorDictSequential) -> Kernel:
    """The kernel that serves an environment, if the policy and strategy can be compiled too.

    Raises:
        NotCompilableError: with the reason.
    """
    from trl_explore.envs import lane_env

    lane = lane_env(env).envs[0]
    while isinstance(lane, gym.Wrapper):
        if type(lane) not in WRAPPERS:
            raise NotCompilableError(f"the wrapper {type(lane).__name__} is not known to it")
        lane = lane.env
    for transform in env.transform:
        if type(transform) not in TRANSFORMS:
            raise NotCompilableError(f"the transform {type(transform).__name__} is not known to it")
    if type(policy[0]) is not LinearPolicy or len(policy) != 2:
        raise NotCompilableError("the policy is not a LinearPolicy")
    if not isinstance(policy[1], MixtureStrategy):
        raise NotCompilableError(
            f"{type(policy[1]).__name__} is not a mixture of argmax, softmax and uniform"
        )
    try:
        return kernel_of(lane)
    except LookupError as error:
        raise NotCompilableError(str(error.args[0])) from None
