"""What runs its own torch code between two steps: policies, strategies, and transforms."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import Transform, TransformedEnv

from trl_explore.collectors.collector import EpisodeCollector
from trl_explore.collectors.compilable import NotCompilableError, has_inverse, has_mask
from trl_explore.collectors.stepping.turn import State
from trl_explore.collectors.torchrl import Noise
from trl_explore.envs import lane_env

INPUTS = {"trial", "observation", "action_mask", "noise", "step_count"}
"""The entries that the modules may read."""


class Modules:
    """The modules of a collector's policy, which act on the outputs of the lanes in place.

    Args:
        collector: the collector.
        state: its arrays ``given`` and ``given_log_prob`` get the actions of the lanes.
        observation: what the policy reads [trials, n_features].

    Raises:
        NotCompilableError: if a module reads an entry that there is not.
    """

    def __init__(
        self, collector: EpisodeCollector, state: State, observation: NDArray[np.float32]
    ) -> None:
        self.collector = collector
        lanes, trials = collector.lanes, collector.trials
        written: set[object] = set()
        for module in collector.policy:
            if missing := set(module.in_keys) - INPUTS - written:
                raise NotCompilableError(
                    f"{type(module).__name__} reads {', '.join(sorted(map(str, missing)))}"
                )
            written |= set(module.out_keys)
        if "action" not in written:
            raise NotCompilableError(f"{type(collector.strategy).__name__} has renamed entries")
        outputs = lanes.outputs
        self.inputs = {
            "trial": torch.arange(trials),
            "observation": torch.from_numpy(observation),
            "step_count": torch.from_numpy(state.length).unsqueeze(-1),
        }
        if lanes.has_masks:
            self.inputs["action_mask"] = torch.from_numpy(outputs.mask)
        self.action = torch.from_numpy(state.given).view(trials, -1)
        if collector.strategy.actions == "discrete":
            self.action = self.action.view(trials)
        self.log_prob = torch.from_numpy(state.given_log_prob)
        self.exact = collector.strategy.exact

    def begin(self, active: NDArray[np.bool_], episodes: NDArray[np.int64]) -> None:
        """Prepare for the episodes ``episodes`` of the active lanes."""
        self.collector.lanes.outputs.mask[~active] = True  # a strategy refuses an empty mask
        self.noise = Noise(self.collector, np.flatnonzero(active), episodes)

    def act(self) -> None:
        """Give every lane an action.

        Raises:
            ValueError: if the actions have another shape.
        """
        noise = self.noise.step(self.collector.lanes.running)
        td = TensorDict._new_unsafe({**self.inputs, "noise": noise}, self.action.shape[:1])
        for module in self.collector.policy:
            module(td)
        action = td.get("action")
        if action.shape != self.action.shape:
            raise ValueError(
                f"{type(self.collector.strategy).__name__} wrote actions of shape "
                f"{list(action.shape)}, not {list(self.action.shape)}"
            )
        self.action.copy_(action)
        if self.exact:
            self.log_prob.copy_(td.get("action_log_prob"))


class Transformed:
    """What the transforms make of the outputs of all lanes, called once per step.

    A transform gets every lane, as in TorchRL's own stepping, so that it may keep state per trial.

    Attributes:
        observation: the policy's input [trials, n_features].
        reward: what the loss sees [trials].

    Raises:
        NotCompilableError: if a transform changes actions or masks.
    """

    def __init__(self, env: TransformedEnv) -> None:
        self.env, self.lanes = env, lane_env(env)
        self.transforms = list(cast(Iterable[Transform], env.transform))
        for transform in self.transforms:
            name = type(transform).__name__
            if has_inverse(transform):
                raise NotCompilableError(f"the transform {name} changes what the environment gets")
            if "action_mask" in transform.out_keys:
                raise NotCompilableError(f"the transform {name} changes the action mask")
        self.observation = np.zeros(tuple(env.observation_spec["observation"].shape), np.float32)
        self.reward = np.zeros(len(self.observation), np.float32)
        self._trial = torch.arange(len(self.observation))
        self._action = cast(torch.Tensor, env.action_spec.zero())
        self._masked = has_mask(env)
        self._data: TensorDictBase = TensorDict({}, self._trial.shape)

    def begin(self, active: NDArray[np.bool_]) -> None:
        """Begin an episode in the active lanes."""
        reset = TensorDict({"_reset": torch.from_numpy(active).unsqueeze(-1)}, self._trial.shape)
        self._data = self.env.reset(reset)
        self.reward[:] = 0
        self._read()

    def step(self, rows: NDArray[np.int64], action: NDArray[Any]) -> None:
        """Transform the outputs of the lanes after the actions of the lanes ``rows``."""
        outputs, data = self.lanes.outputs, self._data
        self._action.numpy()[rows] = action
        columns = {
            "observation": torch.from_numpy(outputs.observation.copy()),
            "reward": torch.from_numpy(outputs.reward.astype(np.float32)).unsqueeze(-1),
            "terminated": torch.from_numpy(outputs.terminated.copy()).unsqueeze(-1),
            "truncated": torch.from_numpy(outputs.truncated.copy()).unsqueeze(-1),
        }
        columns["done"] = columns["terminated"] | columns["truncated"]
        if self._masked:
            columns["action_mask"] = torch.from_numpy(outputs.mask.copy())
        data.set("action", self._action.clone()).set("trial", self._trial)
        after: TensorDictBase = TensorDict._new_unsafe(columns, self._trial.shape)
        for transform in self.transforms:
            after = transform._step(data, after)
        self.reward[:] = after.get("reward").squeeze(-1).numpy()
        self._data = self.env._step_mdp(data.set("next", after))
        self._read()

    def _read(self) -> None:
        self.observation[:] = self._data.get("observation").numpy()
        self.lanes.check_transformed(self.observation, self.reward)
