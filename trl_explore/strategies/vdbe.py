"""VDBE: an ε that follows the learning progress."""

from __future__ import annotations

import math
from typing import Any, Unpack

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from trl_explore.checks import check_number
from trl_explore.strategies.discrete import Options
from trl_explore.strategies.frames import read, readable
from trl_explore.strategies.mixture import Mixture, MixtureStrategy


class VDBE(MixtureStrategy):
    """ε-greedy with one ε per trial, large while the trial's mean score changes.

    μ(a|s) = (1 − ε) · 1[a ∈ A*] / |A*| + ε / n_actions,  with, after iteration i of mean score G,

        V' = V + α (G − V),   Δ = (V' − V) / max(|V'|, |V|),   V = 0 before the first
        f(Δ, σ) = (1 − e^{−|Δ|/σ}) / (1 + e^{−|Δ|/σ}) = tanh(|Δ| / 2σ)
        ε' = δ · f(Δ, σ) + (1 − δ) · ε

    f is the difference of the two Boltzmann probabilities of V and V'. (Tokic 2010, "Adaptive
    ε-Greedy Exploration in Reinforcement Learning Based on Value Differences", §3, "VDBE".) In the
    paper V is a state-action value and ε belongs to a state. A policy gradient has no values, so
    here V is a running mean of the trial's scores. Δ is relative to V and has no unit, so one σ
    suits scores of 10 and of −500. If the score never changes (always 0 before the first goal), Δ
    is 0 and ε falls to 0.

    The scores are ("next", "episode_reward") where ("next", "done") is true, in the data given to
    ``step`` (TorchRL's ``RewardSum`` writes them); without data ε does not change.

    Args:
        initial: ε in iteration 0, in [0, 1].
        sigma: σ > 0, the inverse sensitivity.
        delta: δ in [0, 1]; Tokic uses 1 / n_actions.
        step_size: α in (0, 1].
        score_key: the entry of "next" with the scores.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if an argument is out of range.

    Example:
        >>> from tensordict import TensorDict
        >>> strategy = VDBE(sigma=0.5, delta=0.5)
        >>> after = {"done": torch.tensor([[True]]), "episode_reward": torch.tensor([[20.0]])}
        >>> strategy.step(TensorDict({"next": TensorDict(after, [1])}, [1]))
        >>> f"{strategy.epsilon[0]:.4f}"  # Δ = 1: 0.5 tanh(1) + 0.5
        '0.8808'
    """

    epsilon: Tensor
    """ε of each trial [trials]."""
    value: Tensor
    """V of each trial [trials]."""

    def __init__(
        self,
        initial: float = 1.0,
        sigma: float = 0.1,
        delta: float = 0.5,
        step_size: float = 0.1,
        score_key: NestedKey = "episode_reward",
        **options: Unpack[Options],
    ) -> None:
        super().__init__(**options)
        self.initial = check_number("initial", initial, 0, 1)
        self.sigma = check_number("sigma", sigma, 0, low_open=True)
        self.delta = check_number("delta", delta, 0, 1)
        self.step_size = check_number("step_size", step_size, 0, 1, low_open=True)
        self.score_key = score_key
        self._reset(1)

    def allocate(self, policy: TensorDictModuleBase, trials: int) -> None:
        """Reset ε and V of every trial."""
        self._reset(trials)

    def _reset(self, trials: int) -> None:
        place: Any = {"dtype": torch.float64, "device": self.iteration.device}
        self.register_buffer("epsilon", torch.full((trials,), self.initial, **place))
        self.register_buffer("value", torch.zeros(trials, **place))

    def mixture(self) -> Mixture:
        """ε-greedy, with one ε per trial."""
        epsilon = self.epsilon
        if len(epsilon) == 1:
            epsilon = epsilon.item() if readable(epsilon) else epsilon[0]
        return Mixture(greedy=1 - epsilon, uniform=epsilon)

    def step(self, frames: TensorDictBase | int | None = None) -> None:
        """Update V and ε from the scores of the iteration.

        Raises:
            KeyError: if the data have no scores.
        """
        super().step(frames)
        if not isinstance(frames, TensorDictBase):
            return
        done = read(frames, ("next", "done")).reshape(-1)
        scores = read(frames, unravel_key(("next", self.score_key))).reshape(-1)[done].tolist()
        trial = self._trial(frames)
        trials = [0] * len(scores) if trial is None else trial.reshape(-1)[done].tolist()
        own: dict[int, list[float]] = {}
        for k, score in zip(trials, scores, strict=True):
            own.setdefault(k, []).append(score)
        for k, of_trial in own.items():
            self._learn(k, sum(of_trial) / len(of_trial))

    def _learn(self, k: int, score: float) -> None:
        old = float(self.value[k])
        new = old + self.step_size * (score - old)
        largest = max(abs(new), abs(old))
        change = abs(new - old) / largest if largest > 0 else 0.0
        aim = math.tanh(change / (2 * self.sigma))
        self.value[k] = new
        self.epsilon[k] = self.delta * aim + (1 - self.delta) * float(self.epsilon[k])
