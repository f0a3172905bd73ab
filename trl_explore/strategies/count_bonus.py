"""Optimism: a bonus for actions tried less often in a state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import OneHot

from trl_explore.strategies.counts import VisitCounts
from trl_explore.strategies.mixture import Mixture, MixtureStrategy
from trl_explore.strategies.schedules import Schedule
from trl_explore.strategies.strategy import padding_mask, read, rows


class CountBonus(MixtureStrategy):
    """Softmax of the logits plus a bonus per action that shrinks with its visit count.

    μ(·|s) = softmax((logits + b(s, ·)) / T),   b(s, a) = β / √(N(φ(s), a) + 1)

    β / √N(s, a) is the bonus of MBIE-EB (Strehl & Littman 2008, "An analysis of model-based
    interval estimation"), here added to the preferences instead of the reward. Counting the
    current visit (+ 1) keeps it finite. N and the cells φ(s) are those of ``VisitCounts``: states
    under a tabular policy, else the cells of a hash. N counts the trial's frames in
    ``step(data)``, so μ is fixed within an iteration and its probabilities are exact.

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
        if len(self._heads) > 1:
            raise ValueError("CountBonus counts single actions, but the spec has several heads")
        self.observation_key = observation_key
        read = [self.logits_key, observation_key]
        self.in_keys = read  # pyright: ignore[reportAttributeAccessIssue]
        self.visits = VisitCounts(1, bits, n_actions=self._n_actions)

    @property
    def compilable(self) -> bool:
        """Whether ``behaviour_parameters`` holds the bonus: under a tabular policy."""
        return self.visits.one_hot

    @property
    def _n_actions(self) -> int:
        """The number of actions in the spec; 0 without one."""
        return self._heads[0] if self._heads else 0

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
        visits = VisitCounts(
            trials,
            self.visits.bits,
            one_hot=bool(getattr(policy, "tabular", False)),
            n_actions=self._n_actions,
            seed=seed or 0,
            first_trial=first_trial,
        )
        self.visits = visits.to(self.iteration.device)

    def mixture(self) -> Mixture:
        """Softmax of ``preferences``."""
        return Mixture(softmax=1.0, temperature=self.temperature)

    def preferences(self, tensordict: TensorDictBase, logits: Tensor) -> Tensor:
        """Logits plus bonus."""
        trial = self._trial(tensordict)
        visits = self.visits(read(tensordict, self.observation_key), trial, logits.shape[-1])
        return logits + self._bonus(visits.to(logits.dtype), trial)

    def behaviour_parameters(self, parameters: Sequence[Tensor]) -> list[Tensor]:
        """The table of a tabular policy [trials, n_actions, n_states], plus the bonus."""
        (weight,) = parameters
        self.visits.reserve(weight.shape[2], weight.shape[1])
        visits = self._counts.transpose(1, 2).to(weight.dtype)
        trial = torch.arange(len(weight), device=weight.device)
        return [weight.detach() + self._bonus(visits, trial.unsqueeze(-1))]

    def _bonus(self, visits: Tensor, trial: Tensor | None) -> Tensor:
        """B in the shape of the counts."""
        return rows(self.beta, trial, visits) / (visits + 1).sqrt()

    @property
    def _counts(self) -> Tensor:
        """N of each trial [trials, cells, n_actions]."""
        return self.visits.counts

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
        n_actions = self._counts.shape[-1]
        if not n_actions:
            raise ValueError("CountBonus does not know the number of actions: give the spec")
        trial = self._trial(frames)
        trial = None if trial is None else trial[valid]
        observation = read(frames, self.observation_key)[valid]
        self.visits.count(observation, action.long(), trial, n_actions)
