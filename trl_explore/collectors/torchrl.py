"""The reference collector: it runs environment, transforms, policy and strategy unchanged."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.transforms import Transform
from torchrl.envs.utils import set_exploration_type

from trl_explore.collectors.collector import EpisodeCollector, Rollout
from trl_explore.collectors.columns import NEXT, ROOT
from trl_explore.collectors.compilable import has_inverse
from trl_explore.envs.make import own_transforms
from trl_explore.numerics.streams import Stream, generator

NOISE_STEPS = 128
"""The number of steps for which action noise is drawn at a time."""


class TorchRLCollector(EpisodeCollector):
    """Steps any gymnasium environment with any strategy and policy; the reference implementation.

    All lanes share one TorchRL step. The environment does not step a lane that has finished its
    episode, and the rows of that lane are dropped. Arguments and data: see ``EpisodeCollector``.
    """

    def _collect(self, active: NDArray[np.bool_]) -> Rollout:
        parts = [self._episode(active, self.episodes + j) for j in range(self.episodes_per_update)]
        if len(parts) == 1:
            return parts[0]
        frames, scores, lengths = zip(*parts, strict=True)
        data = cast(TensorDictBase, torch.cat(frames))  # pyright: ignore
        data = data[data.get("trial").argsort(stable=True)]
        return Rollout(data, np.stack(scores, 1).reshape(-1), np.stack(lengths, 1).reshape(-1))

    @torch.no_grad()
    def _episode(self, active: NDArray[np.bool_], episodes: NDArray[np.int64]) -> Rollout:
        """The episode ``episodes[k]`` of every active trial k."""
        lanes = self.lanes
        lanes.episodes[:] = episodes
        self.strategy.begin(active, episodes)
        noise = Noise(self, np.flatnonzero(active), episodes)
        trial = torch.arange(self.trials)
        frames: list[TensorDictBase] = []
        score = np.zeros(self.trials)
        running: list[NDArray[np.bool_]] = []
        own = own_transforms(self.env)
        reset = TensorDict({"_reset": torch.from_numpy(active).unsqueeze(-1)}, [self.trials])
        with set_exploration_type(self.exploration_type):
            td = self.env.reset(reset)
            lanes.running[~active] = False
            if lanes.has_masks:  # TorchRL fills rows that are not reset with zeros
                td.get("action_mask")[~torch.from_numpy(active)] = True
            while lanes.running.any():
                td.set("trial", trial)
                td.set("noise", noise.step(lanes.running))
                running.append(lanes.running.copy())
                for module in self.policy:
                    module(td)
                td.set("next", self._next(td))
                score += lanes.outputs.reward
                frames.append(self._frame(td))
                td = self.env._step_mdp(td)
                if own:
                    made = td.get("observation"), frames[-1].get(("next", "reward"))
                    lanes.check_transformed(*(x.numpy() for x in made))
        mask = np.stack(running, 1)
        length = mask.sum(1)[active]
        data = cast(TensorDictBase, TensorDict.stack(frames, 1))
        return Rollout(data[torch.from_numpy(mask)], score[active], length)

    def _next(self, td: TensorDictBase) -> TensorDictBase:
        """The "next" entry that ``env.step`` writes.

        ``env.step`` spends three quarters of its time on work that is the same at every step:
        partial steps, completion of done entries, copies for inverse transforms. If no transform
        has an inverse, this calls the base environment and the transforms directly.
        """
        if self._has_inverse:
            return self.env.step(td).get("next")
        after = self.env.base_env._step(td)
        for name in NEXT[:4]:
            signal = after.get(name)
            if signal.ndim == 1:
                after.set(name, signal.unsqueeze(-1))
        for transform in self._transforms:
            after = transform._step(td, after)
        return after

    @cached_property
    def _transforms(self) -> list[Transform]:
        return list(cast(Iterable[Transform], self.env.transform or ()))

    @cached_property
    def _has_inverse(self) -> bool:
        return any(map(has_inverse, self._transforms))

    def _frame(self, td: TensorDictBase) -> TensorDictBase:
        source = {key: td.get(key) for key in ROOT if key in td}
        after = td.get("next")
        source["next"] = TensorDict._new_unsafe(
            {key: after.get(key) for key in NEXT}, batch_size=td.batch_size
        )
        return TensorDict._new_unsafe(source, batch_size=td.batch_size)


class Noise:
    """The action noise u of the lanes, step by step; each trial has its own stream."""

    def __init__(
        self, collector: EpisodeCollector, lanes: NDArray[np.int64], episodes: NDArray[np.int64]
    ) -> None:
        env = collector.lanes
        self.generators = {
            int(k): generator(env.seed, Stream.ACTION, env.first_trial + int(k), int(episodes[k]))
            for k in lanes
        }
        size = collector.strategy.noise_size
        shape = (env.num_envs,) if size == 1 else (env.num_envs, size)
        self.block = torch.zeros(NOISE_STEPS, *shape, dtype=torch.float64)
        self.t = 0

    def step(self, running: NDArray[np.bool_]) -> torch.Tensor:
        """The noise for the next step [trials], or [trials, noise_size]."""
        row = self.t % NOISE_STEPS
        if row == 0:
            block = self.block.numpy()
            for lane in np.flatnonzero(running).tolist():
                block[:, lane] = self.generators[lane].random(block[:, lane].shape)
        self.t += 1
        return self.block[row]
