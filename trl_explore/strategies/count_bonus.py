"""Optimism: a bonus for actions tried less often in a state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import OneHot

from trl_explore.checks import check_integer
from trl_explore.numerics.layers import lane_linear, plain_lane_linear
from trl_explore.numerics.streams import Stream, generator
from trl_explore.strategies.mixture import Mixture, MixtureStrategy
from trl_explore.strategies.schedules import Schedule
from trl_explore.strategies.strategy import padding_mask, read, rows


class CountBonus(MixtureStrategy):
    """Softmax of the logits plus a bonus per action that shrinks with its visit count.

    μ(·|s) = softmax((logits + b(s, ·)) / T),   b(s, a) = β / √(N(φ(s), a) + 1)
    φ(s) = sgn(A s) ∈ {−1, 1}^bits,   A [bits, n_features] of independent N(0, 1)

    β / √N(s, a) is the bonus of MBIE-EB (Strehl & Littman 2008, "An analysis of model-based
    interval estimation"), here added to the preferences instead of the reward. Counting the
    current visit (+ 1) keeps it finite. φ is the static hash of Tang et al. 2017, "#Exploration",
    §2.2: each discrete (one-hot) state has a cell; a continuous state has the cell of its
    direction. Each trial has its own A and N. N counts the trial's frames in ``step(data)``, so μ
    is fixed within an iteration and its probabilities are exact.

    Also reads "observation" [*batch, n_features], from the frames and from the data. Padding of
    TorchRL's ``split_trajs`` is not counted. Where a trainer's counts are sent to workers, give the
    action spec, so that N has its size from the start.

    Args:
        beta: β >= 0, a number, one number per trial, or a schedule of the iteration.
        temperature: T >= 0, in the same forms as ``beta``; 0 gives the argmax of the sum.
        bits: length of the hash, 1 to 20; there are 2^bits cells of n_actions counts per trial.
        observation_key: the entry with the observation.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if an argument is out of range.

    Example:
        >>> from tensordict import TensorDict
        >>> strategy = CountBonus(beta=2.0)
        >>> state = {"logits": torch.zeros(1, 2), "observation": torch.ones(1, 3)}
        >>> seen = TensorDict({"observation": torch.ones(3, 3), "action": torch.ones(3).long()}, 3)
        >>> _ = strategy(TensorDict(state, 1))
        >>> strategy.step(seen)
        >>> strategy.preferences(TensorDict(state, 1), state["logits"])
        tensor([[2., 1.]])
    """

    _counts: Tensor
    """N of each trial [trials, cells, n_actions]."""
    beta: Tensor
    temperature: Tensor

    def __init__(
        self,
        beta: float | Sequence[float] | Schedule = 1.0,
        temperature: float | Sequence[float] | Schedule = 1.0,
        bits: int = 12,
        observation_key: NestedKey = "observation",
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.follow("beta", beta, 0, float("inf"))
        self.follow("temperature", temperature, 0, float("inf"))
        self.bits = check_integer("bits", bits, 1, 20)
        if len(self._heads) > 1:
            raise ValueError("CountBonus counts single actions, but the spec has several heads")
        self.observation_key = observation_key
        read = [self.logits_key, observation_key]
        self.in_keys = read  # pyright: ignore[reportAttributeAccessIssue]
        self._whom = (1, 0, 0)  # trials, seed, first trial
        self._hash = torch.zeros(0, 0, 0)
        self._reset(self._heads[0] if self._heads else 0)

    def _reset(self, n_actions: int) -> None:
        shape = (self._whom[0], 1 << self.bits, n_actions)
        counts = torch.zeros(shape, dtype=torch.int32, device=self.iteration.device)
        self.register_buffer("_counts", counts)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *rest: Any) -> None:
        saved = state_dict.get(f"{prefix}_counts")
        if saved is not None and saved.shape[:2] == self._counts.shape[:2]:
            self._reset(saved.shape[-1])
        super()._load_from_state_dict(state_dict, prefix, *rest)

    def bind(
        self,
        policy: TensorDictModuleBase,
        trials: int,
        *,
        seed: int | None = None,
        first_trial: int = 0,
    ) -> None:
        """Reset the counts to 0."""
        super().bind(policy, trials, seed=seed, first_trial=first_trial)
        self._whom = (trials, seed or 0, first_trial)
        self._hash = torch.zeros(0, 0, 0)
        self._reset(self._heads[0] if self._heads else 0)

    def mixture(self) -> Mixture:
        """Softmax of ``preferences``."""
        return Mixture(softmax=1.0, temperature=self.temperature)

    def preferences(self, tensordict: TensorDictBase, logits: Tensor) -> Tensor:
        """Logits plus bonus."""
        if self._counts.shape[-1] != logits.shape[-1]:
            self._reset(logits.shape[-1])
        trial = self._trial(tensordict)
        observation = read(tensordict, self.observation_key)
        visits = self._counts[self._cells(observation, trial)]
        beta = rows(self.beta, trial, logits)
        return logits + beta / (visits.to(logits.dtype) + 1).sqrt()

    def step(self, frames: TensorDictBase | int | None = None) -> None:
        """Count the frames of the iteration.

        Raises:
            ValueError: if the number of actions is not known yet, from the spec or a first frame.
        """
        super().step(frames)
        if not isinstance(frames, TensorDictBase):
            return
        valid = padding_mask(frames)
        action = read(frames, self.action_key)[valid]
        if isinstance(self.spec, OneHot):
            action = action.int().argmax(-1)
        if not self._counts.numel():
            raise ValueError("CountBonus does not know the number of actions: give the spec")
        trial = self._trial(frames)
        trial, cell = self._cells(
            read(frames, self.observation_key)[valid], None if trial is None else trial[valid]
        )
        ones = torch.ones_like(action, dtype=torch.int32)
        self._counts.index_put_((trial, cell, action.long()), ones, accumulate=True)

    def _cells(self, observation: Tensor, trial: Tensor | None) -> tuple[Tensor, Tensor]:
        """The trial and cell of each observation, both [*batch]."""
        if self._hash.shape[-1] != observation.shape[-1]:
            self._hash = _projections(*self._whom, self.bits, observation.shape[-1])
        self._hash = self._hash.to(observation.device)
        place: Any = {"dtype": torch.int64, "device": observation.device}
        batch = observation.shape[:-1]
        if trial is None:
            trial = torch.zeros((), **place)
        trial = trial.reshape(trial.shape + (1,) * (len(batch) - trial.ndim)).expand(batch)
        linear = plain_lane_linear if torch.compiler.is_compiling() else lane_linear
        positive = linear(observation.to(torch.float32), self._hash, trial) > 0
        return trial, (positive * (1 << torch.arange(self.bits, **place))).sum(-1)


@torch._dynamo.assume_constant_result
def _projections(trials: int, seed: int, first_trial: int, bits: int, n_features: int) -> Tensor:
    """A of every trial [trials, bits, n_features]."""
    drawn = [
        generator(seed, Stream.STRATEGY, first_trial + k).standard_normal(
            (bits, n_features), np.float32
        )
        for k in range(trials)
    ]
    return torch.from_numpy(np.stack(drawn))
