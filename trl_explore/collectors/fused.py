"""The collector that compiles what environment, policy and strategy say."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, cast

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
from torch import nn
from torchrl.data import OneHot
from torchrl.envs import RewardSum, StepCounter, Transform, TransformedEnv
from torchrl.envs.utils import ExplorationType

from trl_explore.checks import check_integer
from trl_explore.collectors.base import EpisodeCollector
from trl_explore.collectors.loop import compile_loop, scratch
from trl_explore.collectors.networks import Network, arrays, network_of
from trl_explore.envs import lane_env
from trl_explore.kernels import Kernel, kernel_of
from trl_explore.policies.base import is_one_hot
from trl_explore.strategies import BaseStrategy, MixtureStrategy, Strategy
from trl_explore.streams import Stream, key
from trl_explore.threads import pool

WRAPPERS = (TimeLimit, OrderEnforcing, PassiveEnvChecker, FlattenObservation, DtypeObservation)
TRANSFORMS = (StepCounter, RewardSum)

MIN_TRIALS = 64
"""Trials for each thread below which dividing them costs more than it saves."""
ROOT = ("trial", "observation", "action", "action_log_prob", "action_mask")
NEXT = ("reward", "done", "terminated", "truncated", "step_count", "episode_reward")


class NotCompilableError(ValueError):
    """What the fused collector was given and cannot compile; the message says why."""


class Columns:
    """Flat arrays for frames, kept from call to call, that grow when an episode might not fit."""

    def __init__(self, n_features: int, n_masks: int = 0) -> None:
        self.n_features, self.n_masks = n_features, n_masks
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
            ((self.n_masks,), np.bool_),  # action_mask
        )
        grown = tuple(np.empty((capacity, *shape), dtype) for shape, dtype in shapes)
        for new, old in zip(grown, self.arrays, strict=False):
            new[:used] = old[:used]
        self.capacity, self.arrays = capacity, grown
        root = (*grown[:4], *([grown[10]] if self.n_masks else []))
        self._root = dict(zip(ROOT, map(torch.from_numpy, root), strict=False))
        after = (torch.from_numpy(array).unsqueeze(-1) for array in grown[4:10])
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
        NotCompilableError: with the reason, if the environment has no kernel, or a wrapper,
            transform, policy or strategy is not of a kind that the loop knows.
    """

    def __init__(
        self,
        env: TransformedEnv,
        policy: TensorDictSequential,
        *,
        exploration_type: ExplorationType | None = None,
        threads: int = 1,
        **options: Any,
    ) -> None:
        super().__init__(env, policy, exploration_type=exploration_type, **options)
        self.kernel, self.network, self._parameters = compilable(env, policy)
        if self.episodes_per_update > 1 and type(self.strategy).begin is not BaseStrategy.begin:
            name = type(self.strategy).__name__
            raise NotCompilableError(f"{name} prepares for every episode, and there are several")
        masked = has_mask(env)
        self._loop = compile_loop(self.kernel, self.network, masked)
        self.threads = check_integer("threads", threads, 1)
        n_masks = self.kernel.n_actions if masked else 0
        self._workers = [
            (
                Columns(self.kernel.n_features, n_masks),
                scratch(self.kernel, self.network, self.lanes.max_steps, masked),
            )
            for _ in range(threads)
        ]

    def _collect(self, active: NDArray[np.bool_]) -> TensorDictBase:
        trials = np.repeat(np.flatnonzero(active), self.episodes_per_update)
        self.strategy.begin(active, self.episodes)
        explore = self.exploration_type == ExplorationType.RANDOM
        strategy = cast(MixtureStrategy, self.strategy)
        acting = strategy.behaviour_parameters(self._parameters) if explore else self._parameters
        context = (
            self.lanes.first_trial,
            key(self.lanes.seed, self.lanes.stream),
            key(self.lanes.seed, Stream.ACTION),
            arrays(self.network, acting),
            self._mixture(),
            explore,
        )
        numbers = np.arange(len(trials)) % self.episodes_per_update
        episodes = self.episodes[trials] + numbers
        workers = self._workers if len(trials) >= MIN_TRIALS * self.threads else self._workers[:1]
        if len(workers) == 1:
            return workers[0][0].frames(self._run(workers[0], trials, episodes, context))
        threads = pool()
        parts = np.array_split(np.arange(len(trials)), len(workers))
        calls = [
            threads.submit(self._run, worker, trials[part], episodes[part], context)
            for worker, part in zip(workers, parts, strict=True)
        ]
        sizes = [call.result() for call in calls]
        columns = [worker[0] for worker in workers]
        columns[0].reserve(sum(sizes), sizes[0])
        ends = np.cumsum(sizes).tolist()
        copies = [
            threads.submit(np.copyto, own[ends[i - 1] : ends[i]], array[: sizes[i]])
            for i in range(1, len(workers))
            for own, array in zip(columns[0].arrays, columns[i].arrays, strict=True)
        ]
        for copy in copies:
            copy.result()
        return columns[0].frames(ends[-1])

    def _run(
        self,
        worker: tuple[Columns, tuple[NDArray[Any], ...]],
        trials: NDArray[np.int64],
        episodes: NDArray[np.int64],
        context: tuple[Any, ...],
    ) -> int:
        """Fill a worker's columns with episodes of ``trials``; returns the number of frames."""
        columns, memory = worker
        columns.reserve(len(trials) * 64)
        finished = frames = 0
        while True:
            done, frames = self._loop(
                self.kernel.parameters, trials[finished:], episodes[finished:], *context,
                memory, columns.arrays, frames,
            )  # fmt: skip
            finished += done
            if finished == len(trials):
                return frames
            columns.reserve(2 * columns.capacity, frames)

    def _mixture(self) -> NDArray[np.float64]:
        """Weights and temperature [4, 1], or [4, trials] where they differ between trials."""
        strategy = self.strategy
        assert isinstance(strategy, MixtureStrategy)
        point = strategy.mixture()
        if all(isinstance(value, float) for value in point):
            return np.array(point).reshape(4, 1)
        return np.stack(np.broadcast_arrays(*map(np.atleast_1d, point))).astype(np.float64)


def has_mask(env: TransformedEnv) -> bool:
    """Whether an environment says which actions are allowed."""
    return env.observation_spec.get("action_mask", None) is not None


def compilable(
    env: TransformedEnv, policy: TensorDictSequential
) -> tuple[Kernel, Network, list[nn.Parameter]]:
    """The kernel that serves an environment, and the policy's code and parameters.

    Raises:
        NotCompilableError: with the reason.
    """
    lane = lane_env(env).envs[0]
    while isinstance(lane, gym.Wrapper):
        if type(lane) not in WRAPPERS:
            raise NotCompilableError(f"the wrapper {type(lane).__name__} is not known to it")
        lane = lane.env
    for transform in cast(Iterable[Transform], env.transform or ()):
        if type(transform) not in TRANSFORMS:
            raise NotCompilableError(f"the transform {type(transform).__name__} is not known to it")
    served = network_of(policy[0], one_hot=is_one_hot(env)) if len(policy) == 2 else None
    if served is None:
        raise NotCompilableError(f"the policy {_names(policy)} is not known to it")
    check_strategy(policy[1])
    try:
        kernel = kernel_of(lane)
    except LookupError as error:
        raise NotCompilableError(str(error.args[0])) from None
    if has_mask(env) and kernel.mask is None:
        raise NotCompilableError(f"the kernel of {type(lane).__name__} has no action mask")
    check_sizes(env, kernel, *served)
    return kernel, *served


def _names(policy: TensorDictSequential) -> str:
    """The modules before the strategy."""
    return ", ".join(type(module).__name__ for module in policy.module[:-1])


def check_sizes(
    env: TransformedEnv, kernel: Kernel, network: Network, parameters: list[nn.Parameter]
) -> None:
    """Compiled code reads beside an array that is too short: compare all sizes before.

    Raises:
        NotCompilableError: with those that differ.
    """
    sizes = (kernel.n_actions, kernel.n_features)
    lanes = lane_env(env)
    served = (int(lanes.single_action_space.n), *(lanes.single_observation_space.shape or ()))  # type: ignore[attr-defined]
    if served != sizes:
        raise NotCompilableError(
            f"the kernel is made for (actions, features) {sizes}, not {served}"
        )
    first = parameters[0]
    if (network.sizes[-1], network.sizes[0]) != sizes or len(first) != lanes.num_envs:
        raise NotCompilableError(
            f"the weights are {list(first.shape)} for (trials, actions, features) "
            f"{(lanes.num_envs, *sizes)}"
        )
    for parameter in parameters:
        if parameter.dtype != torch.float32 or not parameter.is_cpu:
            raise NotCompilableError(
                f"the weights are {parameter.dtype} on {parameter.device}, not torch.float32 on cpu"
            )


def check_strategy(strategy: Any) -> None:
    """Refuse a strategy that does more than its mixture says.

    Raises:
        NotCompilableError: with the reason.
    """
    kind, name = type(strategy), type(strategy).__name__
    if not isinstance(strategy, MixtureStrategy):
        raise NotCompilableError(f"{name} is not a mixture of argmax, softmax and uniform")
    if kind.probs is not MixtureStrategy.probs or kind.forward is not Strategy.forward:
        raise NotCompilableError(f"{name} changes probs or forward")
    if kind.explore is not Strategy.explore:
        raise NotCompilableError(f"{name} draws its actions in a way of its own")
    unstated = kind.behaviour_parameters is MixtureStrategy.behaviour_parameters
    if kind.preferences is not Strategy.preferences and unstated:
        raise NotCompilableError(f"{name} changes the logits, and not by the parameters")
    keys = (strategy.logits_key, strategy.action_key, strategy.action_mask_key)
    if keys != ("logits", "action", "action_mask") or isinstance(strategy.spec, OneHot):
        raise NotCompilableError(f"{name} has a one-hot action or renamed entries")
