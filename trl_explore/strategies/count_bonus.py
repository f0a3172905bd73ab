"""Optimism: a bonus for actions tried less often in a state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from trl_explore.checks import check_integer
from trl_explore.numerics.layers import lane_linear
from trl_explore.numerics.streams import Stream, generator
from trl_explore.strategies.mixture import Mixture, MixtureStrategy, rows
from trl_explore.strategies.schedules import Schedule, as_schedule


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

    Also reads "observation" [*batch, n_features], from the frames and from the data.

    Args:
        beta: β >= 0, a number, one number per trial, or a schedule of the iteration.
        temperature: T >= 0, in the same forms as ``beta``; 0 gives the argmax of the sum.
        bits: length of the hash, 1 to 20; there are 2^bits cells of n_actions counts per trial.
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

    def __init__(
        self,
        beta: float | Sequence[float] | Schedule = 1.0,
        temperature: float | Sequence[float] | Schedule = 1.0,
        bits: int = 12,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.beta = as_schedule("beta", beta, 0, float("inf"))
        self.temperature = as_schedule("temperature", temperature, 0, float("inf"))
        self.bits = check_integer("bits", bits, 1, 20)
        read = [self.logits_key, "observation"]
        self.in_keys = read  # pyright: ignore[reportAttributeAccessIssue]
        self._whom = (1, 0, 0)  # trials, seed, first trial
        self._hash = torch.zeros(0)
        self._counts = torch.zeros(0, dtype=torch.int32)

    def bind(
        self, policy: TensorDictModuleBase, trials: int, *, seed: int = 0, first_trial: int = 0
    ) -> None:
        """Reset the counts to 0."""
        super().bind(policy, trials, seed=seed, first_trial=first_trial)
        self._whom = (trials, seed, first_trial)
        self._hash, self._counts = torch.zeros(0), torch.zeros(0, dtype=torch.int32)

    def mixture(self) -> Mixture:
        """Softmax of ``preferences``."""
        return Mixture(softmax=1.0, temperature=self.temperature(self.iteration))

    def preferences(self, tensordict: TensorDictBase, logits: Tensor) -> Tensor:
        """Logits plus bonus."""
        self._prepare(tensordict.get("observation").shape[-1], logits.shape[-1])
        visits = self._counts[self._cells(tensordict)]
        beta = rows(self.beta(self.iteration), tensordict.get("trial", None), logits)
        return logits + beta / (visits.to(logits.dtype) + 1).sqrt()

    def step(self, data: TensorDictBase | None = None) -> None:
        """Count the frames of the iteration."""
        super().step(data)
        if data is None or not self._counts.numel():
            return
        action = data.get(self.action_key)
        if action.ndim > data.get("observation").ndim - 1:
            action = action.int().argmax(-1)
        trial, cell = self._cells(data)
        ones = torch.ones_like(action, dtype=torch.int32)
        self._counts.index_put_((trial, cell, action.long()), ones, accumulate=True)

    def _prepare(self, n_features: int, n_actions: int) -> None:
        """Draw A and allocate N when the sizes are first known."""
        if self._counts.numel():
            return
        trials, seed, first_trial = self._whom
        shape = (self.bits, n_features)
        drawn = [
            generator(seed, Stream.STRATEGY, first_trial + k).standard_normal(shape, np.float32)
            for k in range(trials)
        ]
        self._hash = torch.from_numpy(np.stack(drawn))
        self._counts = torch.zeros(trials, 1 << self.bits, n_actions, dtype=torch.int32)

    def _cells(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """The trial and cell of each frame, both [*batch]."""
        observation = tensordict.get("observation").to(torch.float32)
        trial = tensordict.get("trial", None)
        if trial is None:
            trial = torch.zeros(observation.shape[:-1], dtype=torch.int64)
        positive = lane_linear(observation, self._hash, trial) > 0
        return trial, (positive * (1 << torch.arange(self.bits))).sum(-1)

    def get_extra_state(self) -> dict[str, Any]:
        """The state for ``state_dict``, including A and N of every trial."""
        visited = {"hash": self._hash.clone(), "counts": self._counts.clone()}
        return {**super().get_extra_state(), **visited}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore the state from ``get_extra_state``."""
        super().set_extra_state(state)
        self._hash, self._counts = state["hash"].clone(), state["counts"].clone()
