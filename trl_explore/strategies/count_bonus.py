"""Optimism: a bonus for actions tried less often in a state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from trl_explore.strategies.counts import VisitCounts
from trl_explore.strategies.mixture import Mixture, MixtureStrategy, rows
from trl_explore.strategies.schedules import Schedule, as_schedule


class CountBonus(MixtureStrategy):
    """Softmax of the logits plus a bonus per action that shrinks with its visit count.

    μ(·|s) = softmax((logits + b(s, ·)) / T),   b(s, a) = β / √(N(φ(s), a) + 1)

    β / √N(s, a) is the bonus of MBIE-EB (Strehl & Littman 2008, "An analysis of model-based
    interval estimation"), here added to the preferences instead of the reward. Counting the
    current visit (+ 1) keeps it finite. N and the cells φ(s) are those of ``VisitCounts``: states
    under a tabular policy, else the cells of a hash. N counts the trial's frames in
    ``step(data)``, so μ is fixed within an iteration and its probabilities are exact.

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
        read = [self.logits_key, "observation"]
        self.in_keys = read  # pyright: ignore[reportAttributeAccessIssue]
        self.visits = VisitCounts(1, bits)

    @property
    def compilable(self) -> bool:
        """Whether ``behaviour_parameters`` holds the bonus: under a tabular policy."""
        return self.visits.one_hot

    def bind(
        self, policy: TensorDictModuleBase, trials: int, *, seed: int = 0, first_trial: int = 0
    ) -> None:
        """Reset the counts to 0."""
        super().bind(policy, trials, seed=seed, first_trial=first_trial)
        tabular = bool(getattr(policy, "tabular", False))
        streams = {"seed": seed, "first_trial": first_trial}
        self.visits = VisitCounts(trials, self.visits.bits, one_hot=tabular, **streams)

    def mixture(self) -> Mixture:
        """Softmax of ``preferences``."""
        return Mixture(softmax=1.0, temperature=self.temperature(self.iteration))

    def preferences(self, tensordict: TensorDictBase, logits: Tensor) -> Tensor:
        """Logits plus bonus."""
        observation, trial = tensordict.get("observation"), _trial(tensordict)
        visits = self.visits(observation, trial, logits.shape[-1])
        return logits + self._bonus(visits.to(logits.dtype), tensordict.get("trial", None))

    def behaviour_parameters(self, parameters: Sequence[Tensor]) -> list[Tensor]:
        """The table of a tabular policy [trials, n_actions, n_states], plus the bonus."""
        (weight,) = parameters
        self.visits.reserve(weight.shape[2], weight.shape[1])
        visits = self.visits.counts.transpose(1, 2).to(weight.dtype)
        trial = torch.arange(len(weight))
        return [weight.detach() + self._bonus(visits, trial.unsqueeze(-1))]

    def _bonus(self, visits: Tensor, trial: Tensor | None) -> Tensor:
        """B in the shape of the counts."""
        return rows(self.beta(self.iteration), trial, visits) / (visits + 1).sqrt()

    def step(self, data: TensorDictBase | None = None) -> None:
        """Count the frames of the iteration."""
        super().step(data)
        n_actions = self.visits.counts.shape[-1]
        if data is None or not n_actions:
            return
        action = data.get(self.action_key)
        if action.ndim > data.get("observation").ndim - 1:
            action = action.int().argmax(-1)
        self.visits.count(data.get("observation"), action.long(), _trial(data), n_actions)


def _trial(tensordict: TensorDictBase) -> Tensor:
    """The trial of each frame; 0 if there is no such entry."""
    trial = tensordict.get("trial", None)
    if trial is None:
        return torch.zeros(tensordict.get("observation").shape[:-1], dtype=torch.int64)
    return trial
