"""The collector that steps any gymnasium environment, and compiles all else that a step needs."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from numpy.typing import NDArray
from tensordict.nn import TensorDictSequential
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from trl_explore.collectors.collector import EpisodeCollector, Rollout
from trl_explore.collectors.columns import Columns, grown
from trl_explore.collectors.compilable import (
    NotCompilableError,
    compilable_policy,
    has_mask,
    mixture_array,
)
from trl_explore.collectors.compiled_policies import arrays
from trl_explore.collectors.stepping.acting import Form
from trl_explore.collectors.stepping.torch_modules import Modules, Transformed
from trl_explore.collectors.stepping.turn import (
    ACT,
    BEGIN,
    RECORD,
    FrameLog,
    State,
    compile_turn,
    deliver,
    log_types,
)
from trl_explore.envs.make import own_transforms
from trl_explore.numerics.streams import Stream, key
from trl_explore.policies.layers import n_actions, n_dims
from trl_explore.strategies import ContinuousMixtureStrategy, MixtureStrategy

FIRST_FRAMES = 64
"""The number of frames per episode to allocate at first."""


class SteppingCollector(EpisodeCollector):
    """Steps any gymnasium environment: per step, ``env.step`` of the running lanes and one call.

    The call is compiled for the policy and the strategy's mixture. It records the outputs of all
    lanes, computes μ and draws the actions. Other policies and strategies, and the user's
    transforms, run their own torch code. With the same seed it gives the same episodes as
    ``TorchRLCollector``, up to floating-point rounding. Arguments and data: see
    ``EpisodeCollector``.

    Attributes:
        why_modules: why the policy and strategy run their torch code; None if they are compiled.

    Raises:
        NotCompilableError: if a transform changes actions or masks, or a module reads an entry
            that only TorchRL's own stepping writes.
    """

    def __init__(self, env: TransformedEnv, policy: TensorDictSequential, **options: Any) -> None:
        super().__init__(env, policy, **options)
        self._transformed = Transformed(env) if own_transforms(env) else None
        seen = self._transformed or self.lanes.outputs
        self._observation = seen.observation
        self._continuous = self.strategy.actions == "continuous"
        network, self._parameters, self.why_modules = None, [], None
        try:
            network, self._parameters = compilable_policy(env, policy, self._observation.shape[1])
        except NotCompilableError as error:
            self.why_modules = str(error)
        self._form = Form(
            network,
            n_features=self._observation.shape[1],
            n_masks=n_actions(env) if has_mask(env) else 0,
            n_dims=n_dims(env) if self._continuous else 0,
            exact=self.strategy.exact,
        )
        form = self._form
        self._turn = compile_turn(form)
        self._state = State.of(form, self.trials)
        self._modules = None if network else Modules(self, self._state, self._observation)
        self._box = self._bounds()
        self._types, self._log, self._capacity = log_types(form), (), 0
        self._columns = Columns(
            form.n_features, n_masks=form.n_masks, n_dims=form.n_dims, exact=form.exact
        )

    def _bounds(self) -> tuple[NDArray[np.float64], ...]:
        """The bounds of a continuous action, and the logarithm of their volume."""
        space = self.lanes.single_action_space
        if not isinstance(space, Box):
            return np.zeros(0), np.zeros(0), np.zeros(1)
        low, high = (torch.from_numpy(bound).double() for bound in (space.low, space.high))
        volume = (high - low).log().sum().reshape(1)
        return low.numpy(), high.numpy(), volume.numpy()

    @torch.no_grad()
    def _collect(self, active: NDArray[np.bool_]) -> Rollout:
        (trials,) = active.nonzero()
        k = self.episodes_per_update
        score, length = np.empty((self.trials, k)), np.zeros((self.trials, k), dtype=np.int64)
        place = 0
        with set_exploration_type(self.exploration_type):
            for j in range(k):
                place = self._round(active, trials, self.episodes + j, place)
                score[:, j], length[:, j] = self._state.score, self._state.length
        score, length = score[trials], length[trials]
        starts = np.zeros(self.trials, dtype=np.int64)
        starts[trials] = np.cumsum(length.sum(1)) - length.sum(1)
        columns, form = self._columns, self._form
        columns.reserve(place)
        deliver(
            place, form.n_features, max(1, form.n_dims), form.n_masks, form.exact, starts,
            np.zeros_like(starts), self._log, columns.arrays,
        )  # fmt: skip
        return Rollout(columns.frames(place), score.reshape(-1), length.reshape(-1))

    def _round(
        self,
        active: NDArray[np.bool_],
        trials: NDArray[np.int64],
        episodes: NDArray[np.int64],
        place: int,
    ) -> int:
        """The episode ``episodes[k]`` of every active trial k; returns the place after it."""
        lanes, state, modules, turn = self.lanes, self._state, self._modules, self._turn
        transformed = self._transformed
        lanes.episodes[:] = episodes
        lanes.running[:] = False
        self.strategy.begin(active, episodes)
        if transformed:
            transformed.begin(active)
            lanes.running[~active] = False
        else:
            lanes.begin(trials)
            lanes.check()
        left = len(trials)
        state.rows[:left], state.episodes[:] = trials, episodes
        self._reserve(place + FIRST_FRAMES * left, place)
        after = 0 if modules else ACT
        if modules:
            modules.begin(active, episodes)
        size = max(1, self._form.n_dims)
        action = state.action.reshape(-1, size) if self._continuous else state.action
        context, rows = self._context(), state.rows
        own = rows
        left, place = turn(BEGIN | after, *context[:2], place, left, *context[2:], self._log)
        while left > 0:
            if modules:
                modules.act()
                turn(ACT, *context[:2], place, left, *context[2:], self._log)
            lanes.advance(rows[:left], action[:left])
            lanes.check()
            if place + 2 * left > self._capacity:
                self._reserve(2 * self._capacity, place + left)
            first = place
            if transformed:
                own = rows[:left].copy()
                transformed.step(own, action[:left])
            left, place = turn(RECORD | after, *context[:2], place, left, *context[2:], self._log)
            if transformed:
                FrameLog(*self._log).reward[first:place] = transformed.reward[own]
        return place

    def _context(self) -> tuple[Any, ...]:
        """The arguments of a turn that do not change within an episode, without parts and place."""
        explore = self.exploration_type == ExplorationType.RANDOM
        mixture, parameters, outputs = np.zeros((4, 1)), self._parameters, self.lanes.outputs
        weights: Any = ()
        if (network := self._form.network) is not None:
            strategy: Any = self.strategy
            if isinstance(strategy, MixtureStrategy):
                mixture = mixture_array(strategy.checked_mixture(self.trials), self.trials)
                if explore:
                    parameters = strategy.behaviour_parameters(parameters)
            elif isinstance(strategy, ContinuousMixtureStrategy):
                mixture = mixture_array(strategy.mixture(), self.trials)
                module: Any = self.policy[0].module
                self._state.scale[:] = module.scale().detach().numpy()
            weights = arrays(network, parameters)
        ends = outputs.terminated, outputs.truncated
        return (
            explore,
            self.lanes.first_trial,
            key(self.lanes.seed, Stream.ACTION).copy(),  # read-only arrays are another type
            weights,
            mixture,
            self._box,
            (self._observation, outputs.reward, *ends, outputs.mask),
            tuple(self._state),
        )

    def _reserve(self, frames: int, keep: int) -> None:
        """Make room for ``frames`` frames in the log, and keep the first ``keep``."""
        if frames > self._capacity:
            self._log = grown(self._types, frames, self._log, keep)
            self._capacity = frames

    def _free(self) -> None:
        self._columns, self._log, self._capacity = Columns(0), (), 0
