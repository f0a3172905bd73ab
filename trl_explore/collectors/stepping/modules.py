"""Policies and strategies that are not compiled: their own torch code."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from trl_explore.collectors.collector import EpisodeCollector
from trl_explore.collectors.compiling import NotCompilableError
from trl_explore.collectors.stepping.turn import State
from trl_explore.collectors.torchrl import Noise

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
        signals = lanes.signals
        self.inputs = {
            "trial": torch.arange(trials),
            "observation": torch.from_numpy(observation),
            "step_count": torch.from_numpy(state.length).unsqueeze(-1),
        }
        if lanes.has_masks:
            self.inputs["action_mask"] = torch.from_numpy(signals.mask)
        self.action = torch.from_numpy(state.given).view(trials, -1)
        if collector.strategy.actions == "discrete":
            self.action = self.action.view(trials)
        self.log_prob = torch.from_numpy(state.given_log_prob)
        self.exact = collector.strategy.exact

    def begin(self, active: NDArray[np.bool_], episodes: NDArray[np.int64]) -> None:
        """Prepare for the episodes ``episodes`` of the active lanes."""
        self.collector.lanes.signals.mask[~active] = True  # a strategy refuses an empty mask
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
