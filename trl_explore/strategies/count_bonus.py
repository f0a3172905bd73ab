"""Counts of what each trial has tried, and a bonus for actions tried less often."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Unpack

import numpy as np
import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from trl_explore.checks import check_integer
from trl_explore.numerics.layers import lane_linear, plain_lane_linear
from trl_explore.numerics.streams import Stream, generator
from trl_explore.strategies.discrete import Options
from trl_explore.strategies.frames import padding_mask, read, rows
from trl_explore.strategies.mixture import Mixture, MixtureStrategy
from trl_explore.strategies.schedules import Parameter


class VisitCounts(nn.Module):
    """N(φ(s), a): how often each trial took action a in the cell φ(s).

    φ(s) = s for one-hot states, else the static hash of Tang et al. 2017, "#Exploration", §2.2:
    φ(s) = sgn(A s) ∈ {−1, 1}^bits with A [bits, n_features] of independent N(0, 1), the cell of the
    direction of s. Each trial has its own A and N.

    Args:
        trials: the number of trials.
        bits: length of the hash, 1 to 20.
        one_hot: whether observations are one-hot states.
        n_actions: the number of actions; 0: taken from the first data.
        seed: seed of the job.
        first_trial: trial index of row 0.

    Raises:
        ValueError: if ``bits`` is out of range.
    """

    counts: Tensor
    """N [trials, cells, n_actions] int32; empty until the sizes are known."""

    def __init__(
        self,
        trials: int,
        bits: int = 12,
        *,
        one_hot: bool = False,
        n_actions: int = 0,
        seed: int = 0,
        first_trial: int = 0,
    ) -> None:
        super().__init__()
        self.trials, self.bits = trials, check_integer("bits", bits, 1, 20)
        self.one_hot, self.seed, self.first_trial = one_hot, seed, first_trial
        self._hash = torch.zeros(0, 0, 0)
        self._allocate(0 if one_hot else 1 << bits, n_actions)

    def forward(self, observation: Tensor, trial: Tensor | None, n_actions: int) -> Tensor:
        """N(φ(s), ·) of each frame [*batch, n_actions]; without a trial, those of row 0."""
        self.reserve(observation.shape[-1], n_actions)
        return self.counts[self._cells(observation, trial)]

    def count(
        self, observation: Tensor, action: Tensor, trial: Tensor | None, n_actions: int
    ) -> None:
        """Count the frames, each with its action [*batch] int64."""
        self.reserve(observation.shape[-1], n_actions)
        ones = torch.ones_like(action, dtype=torch.int32)
        self.counts.index_put_((*self._cells(observation, trial), action), ones, accumulate=True)

    def reserve(self, n_features: int, n_actions: int) -> None:
        """Allocate N when the sizes are first known."""
        cells = n_features if self.one_hot else 1 << self.bits
        if self.counts.shape[1:] != (cells, n_actions):
            self._allocate(cells, n_actions)

    def _allocate(self, cells: int, n_actions: int) -> None:
        device = self.counts.device if hasattr(self, "counts") else None
        counts = torch.zeros(self.trials, cells, n_actions, dtype=torch.int32, device=device)
        self.register_buffer("counts", counts)

    def _cells(self, observation: Tensor, trial: Tensor | None) -> tuple[Tensor, Tensor]:
        """The trial and the cell φ(s) of each frame, both [*batch]."""
        place: Any = {"dtype": torch.int64, "device": observation.device}
        batch = observation.shape[:-1]
        if trial is None:
            trial = torch.zeros((), **place)
        trial = trial.reshape(trial.shape + (1,) * (len(batch) - trial.ndim)).expand(batch)
        if self.one_hot:
            return trial, observation.argmax(-1)
        if self._hash.shape[-1] != observation.shape[-1]:
            streams = self.trials, self.seed, self.first_trial
            self._hash = _projections(*streams, self.bits, observation.shape[-1])
        self._hash = self._hash.to(observation.device)
        linear = plain_lane_linear if torch.compiler.is_compiling() else lane_linear
        positive = linear(observation.to(torch.float32), self._hash, trial) > 0
        return trial, (positive * (1 << torch.arange(self.bits, **place))).sum(-1)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *rest: Any) -> None:
        saved = state_dict.get(f"{prefix}counts")
        if saved is not None and len(saved) == self.trials:
            self._allocate(*saved.shape[1:])
        super()._load_from_state_dict(state_dict, prefix, *rest)


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
        beta: β >= 0, a number, one number per trial, or a schedule.
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
        beta: Parameter = 1.0,
        temperature: Parameter = 1.0,
        bits: int = 12,
        observation_key: NestedKey = "observation",
        **options: Unpack[Options],
    ) -> None:
        super().__init__(**options)
        self.follow("beta", beta)
        self.follow("temperature", temperature)
        if self.joint:
            raise ValueError("CountBonus counts single actions, but the spec has several heads")
        self.observation_key = observation_key
        read = [self.logits_key, observation_key]
        self.in_keys = read  # pyright: ignore[reportAttributeAccessIssue]
        self.visits = VisitCounts(1, bits, n_actions=sum(self.heads))

    @property
    def compilable(self) -> bool:
        """Whether ``behaviour_parameters`` holds the bonus: under a tabular policy."""
        return self.visits.one_hot

    def allocate(self, policy: TensorDictModuleBase, trials: int) -> None:
        """Reset the counts to 0."""
        visits = VisitCounts(
            trials,
            self.visits.bits,
            one_hot=bool(getattr(policy, "tabular", False)),
            n_actions=sum(self.heads),
            seed=self._seed,
            first_trial=self._first_trial,
        )
        self.visits = visits.to(self.iteration.device)

    def mixture(self) -> Mixture:
        """Softmax of ``preferences``."""
        return Mixture(softmax=1.0, temperature=self.now("temperature"))

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
        action = self.index(read(frames, self.action_key)[valid])
        n_actions = self._counts.shape[-1]
        if not n_actions:
            raise ValueError("CountBonus does not know the number of actions: give the spec")
        trial = self._trial(frames)
        trial = None if trial is None else trial[valid]
        observation = read(frames, self.observation_key)[valid]
        self.visits.count(observation, action, trial, n_actions)
