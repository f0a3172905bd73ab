"""The collector that compiles environment, policy and strategy into one loop."""

from __future__ import annotations

from functools import partial
from typing import Any, cast

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import (
    DtypeObservation,
    FlattenObservation,
    OrderEnforcing,
    PassiveEnvChecker,
    TimeLimit,
)
from numpy.typing import NDArray
from tensordict.nn import TensorDictSequential
from torch import nn
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType

from trl_explore.collectors.collector import EpisodeCollector, Rollout
from trl_explore.collectors.columns import Columns
from trl_explore.collectors.compilable import (
    NotCompilableError,
    compilable_policy,
    has_mask,
    mixture_array,
)
from trl_explore.collectors.compiled_policies import Network, arrays
from trl_explore.collectors.fused.loop import compile_loop
from trl_explore.collectors.fused.memory import scratch
from trl_explore.envs import lane_env
from trl_explore.envs.kernels import Kernel, kernel_of
from trl_explore.envs.make import own_transforms
from trl_explore.numerics.streams import Stream, key
from trl_explore.strategies import MixtureStrategy

WRAPPERS = (TimeLimit, OrderEnforcing, PassiveEnvChecker, FlattenObservation, DtypeObservation)

GREEDY = np.array([[1.0], [0.0], [0.0], [1.0]])
"""The mixture without exploration; the loop does not read it then."""
FIRST_FRAMES = 256
"""The number of frames per episode to allocate at first."""


class FusedCollector(EpisodeCollector):
    """Runs whole episodes in machine code, thousands of times faster than stepping TorchRL.

    It compiles the environment's kernel, the supported transforms, the policy and the strategy's
    mixture. With the same seed it gives the same episodes as ``TorchRLCollector``, up to
    floating-point rounding. Arguments and data: see ``EpisodeCollector``.

    Args:
        stream: the random stream of the episodes; None: that of the environment. The environment
            itself is never stepped, so that collectors with different streams can share it;
            each of them closes it.

    Raises:
        NotCompilableError: if the environment has no kernel, or a wrapper, transform, policy or
            strategy is not supported; the message gives the reason.
    """

    parallel = True

    def __init__(
        self,
        env: TransformedEnv,
        policy: TensorDictSequential,
        *,
        stream: Stream | None = None,
        **options: Any,
    ) -> None:
        super().__init__(env, policy, **options)
        self.stream = self.lanes.stream if stream is None else stream
        self._first_trial = self.lanes.first_trial  # which may change in a shared environment
        self.kernel, self.network, self._parameters = compilable(env, policy)
        if self.episodes_per_update > 1 and self.strategy.per_episode:
            name = type(self.strategy).__name__
            raise NotCompilableError(
                f"{name} prepares each episode separately, which needs episodes_per_update=1, "
                f"not {self.episodes_per_update}"
            )
        masked = has_mask(env)
        self._loop = compile_loop(self.kernel, self.network, masked)
        self._outcomes = compile_loop(self.kernel, self.network, masked, records=False)
        self._unrecorded: tuple[Any, ...] = ()
        n_masks = self.kernel.n_actions if masked else 0
        self._columns = Columns(self.kernel.n_features, n_masks=n_masks)
        self._scratch = scratch(
            self.kernel, self.network, self.lanes.max_steps, masked,
            self.trials * self.episodes_per_update,
        )  # fmt: skip

    def _collect(self, active: NDArray[np.bool_]) -> Rollout:
        (trials,) = active.nonzero()
        self.strategy.begin(active, self.episodes)
        episodes = self.episodes[trials]
        if self.episodes_per_update > 1:
            numbers = np.arange(self.episodes_per_update)
            trials = np.repeat(trials, self.episodes_per_update)
            episodes = (episodes[:, None] + numbers).reshape(-1)
        score, length = np.empty(len(trials)), np.empty(len(trials), dtype=np.int64)
        context, columns = self._context(), self._columns
        columns.reserve(FIRST_FRAMES * len(trials))
        done = place = 0
        while True:
            done, place = self._loop(
                self.kernel.parameters, trials, episodes, *context, self._scratch, columns.arrays,
                score, length, done, place,
            )  # fmt: skip
            if done == len(trials):
                frames = partial(columns.frames, place)
                return Rollout(frames, score, length, columns.frame_arrays(place))
            columns.reserve(2 * columns.capacity, keep=place)

    def _play(
        self, trials: NDArray[np.int64], episodes: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        if self.strategy.per_episode:
            return super()._play(trials, episodes)
        if not self._unrecorded:
            self._unrecorded = scratch(
                self.kernel, self.network, self.lanes.max_steps, has_mask(self.env), records=False
            )
        score, length = np.empty(len(trials)), np.empty(len(trials), dtype=np.int64)
        self._columns.reserve(1)
        self._outcomes(
            self.kernel.parameters, trials, episodes, *self._context(), self._unrecorded,
            self._columns.arrays, score, length, 0, 0,
        )  # fmt: skip
        return score, length

    def _check_resumable(self) -> None:
        """A kernel keeps nothing from one episode to the next."""

    def _free(self) -> None:
        self._columns = Columns(0)

    def _context(self) -> tuple[Any, ...]:
        """The loop's arguments for the policy, the strategy and the random streams."""
        explore = self.exploration_type == ExplorationType.RANDOM
        strategy = cast(MixtureStrategy, self.strategy)
        acting = strategy.behaviour_parameters(self._parameters) if explore else self._parameters
        return (
            self._first_trial,
            key(self.lanes.seed, self.stream),
            key(self.lanes.seed, Stream.ACTION),
            arrays(self.network, acting),
            mixture_array(strategy.checked_mixture(self.trials), self.trials)
            if explore
            else GREEDY,
            explore,
        )


def compilable(
    env: TransformedEnv, policy: TensorDictSequential
) -> tuple[Kernel, Network, list[nn.Parameter]]:
    """The kernel of an environment, and the network and parameters of a policy.

    Raises:
        NotCompilableError: with the reason, if one of them is not supported.
    """
    lanes = lane_env(env)
    lane = lanes.envs[0]
    while isinstance(lane, gym.Wrapper):
        if type(lane) not in WRAPPERS:
            raise NotCompilableError(f"it does not support the wrapper {type(lane).__name__}")
        lane = lane.env
    for transform in own_transforms(env):
        name = type(transform).__name__
        raise NotCompilableError(f"it does not support the transform {name}")
    features = lanes.single_observation_space.shape or ()
    network = compilable_policy(env, policy, *features)
    try:
        kernel = kernel_of(lane)
    except LookupError as error:
        raise NotCompilableError(str(error.args[0])) from None
    if has_mask(env) and kernel.mask is None:
        raise NotCompilableError(f"the kernel of {type(lane).__name__} has no action mask")
    sizes = (kernel.n_actions, kernel.n_features)
    own = (int(getattr(lanes.single_action_space, "n", 0)), *features)
    if own != sizes:
        raise NotCompilableError(
            f"the kernel has (actions, features) {sizes}, but the environment has {own}"
        )
    return kernel, *network
