"""ε-greedy with repeated random actions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from trl_explore.checks import check_integer, check_number
from trl_explore.strategies.mixture import Mixture, mixture_probs, rows
from trl_explore.strategies.schedules import Schedule, as_schedule
from trl_explore.strategies.strategy import Strategy, inverse_cdf


class EpsilonZGreedy(Strategy):
    """Argmax; with probability ε instead a uniform action, repeated for n ~ z(μ) frames.

    If no repetition is running: with probability ε draw a ~ uniform and n with

        P(n) = n^−μ / Σ_{k ≤ N} k^−μ,   n = 1, ..., N

    and take a in this frame and the next n − 1; else take an action of largest logit (ties share).
    A repetition ends early if the episode ends or the mask forbids its action. (Dabney, Ostrovski
    & Barreto 2021, "Temporally-Extended ε-Greedy Exploration", §3 and appendix B, with
    zeta-distributed durations, μ = 2, cut at N.)

    ``exact`` is False: the next action depends on a repetition that the state does not show. During
    a repetition, μ given the past is a point mass and lacks the full support that π/μ needs. So no
    log-probability is written, and importance weights cannot correct the data. ``probs`` applies to
    frames without a running repetition: ε-greedy.

    Each frame of a batch is the next frame of a lane, its position in the batch. ``begin`` ends the
    repetition of a lane; for collectors that do not call it, so does a frame whose "is_init" is
    true or whose "step_count" is 0.

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule of the iteration.
        mu: the exponent, > 1; smaller values give longer repetitions.
        max_duration: N >= 1.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if an argument is out of range.

    Example:
        >>> from tensordict import TensorDict
        >>> strategy = EpsilonZGreedy(1.0)
        >>> noise = torch.tensor([[0.0, 0.9, 0.7]])  # explore; action 1; P(n <= 1) = 0.608 < 0.7
        >>> logits = torch.tensor([[5.0, 0.0]])
        >>> frame = TensorDict({"logits": logits, "noise": noise}, [1])
        >>> first = int(strategy(frame)["action"])
        >>> frame["noise"] = torch.zeros(1, 3)
        >>> first, int(strategy(frame)["action"]), int(strategy(frame)["action"])
        (1, 1, 0)
    """

    exact = False
    noise_size = 3

    def __init__(
        self,
        epsilon: float | Sequence[float] | Schedule = 0.1,
        mu: float = 2.0,
        max_duration: int = 10_000,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.epsilon = as_schedule("epsilon", epsilon, 0, 1)
        self.mu = check_number("mu", mu, 1, low_open=True)
        self.max_duration = check_integer("max_duration", max_duration, 1, 10**7)
        weights = np.arange(1, self.max_duration + 1, dtype=np.float64) ** -self.mu
        self._cdf = torch.from_numpy(np.cumsum(weights) / np.sum(weights))
        self._remaining = torch.zeros(0, dtype=torch.int64)
        self._action = torch.zeros(0, dtype=torch.int64)

    def bind(
        self, policy: TensorDictModuleBase, trials: int, *, seed: int = 0, first_trial: int = 0
    ) -> None:
        """Connect the strategy to its target policy."""
        super().bind(policy, trials, seed=seed, first_trial=first_trial)
        self._reset(trials)

    def begin(self, active: NDArray[np.bool_], episodes: NDArray[np.int64]) -> None:
        """End the repetitions of the active trials."""
        if len(self._remaining) != len(active):
            self._reset(len(active))
        self._remaining[torch.from_numpy(active)] = 0

    def _reset(self, lanes: int) -> None:
        self._remaining = torch.zeros(lanes, dtype=torch.int64)
        self._action = torch.zeros(lanes, dtype=torch.int64)

    def probs(self, logits: Tensor, trial: Tensor | None = None) -> Tensor:
        """ε-greedy [*batch, n_actions]: μ if no repetition is running."""
        epsilon = rows(self.epsilon(self.iteration), trial, logits)
        return mixture_probs(logits, Mixture(greedy=1 - epsilon, uniform=epsilon))

    def explore(
        self, tensordict: TensorDictBase, logits: Tensor, noise: Tensor
    ) -> tuple[Tensor, None]:
        """Continue a repetition, or draw; ``noise`` decides whether, which action and how long."""
        batch = logits.shape[:-1]
        if len(self._remaining) != batch.numel():
            self._reset(batch.numel())
        trial = tensordict.get("trial", None)
        epsilon = rows(self.epsilon(self.iteration), trial, logits)
        epsilon = torch.as_tensor(epsilon, dtype=torch.float64, device=logits.device)
        epsilon = epsilon.expand(*batch, 1).squeeze(-1)
        whether, what, how_long = noise.unbind(-1)
        uniform = inverse_cdf(mixture_probs(logits, Mixture(uniform=1.0)), what)
        greedy = inverse_cdf(mixture_probs(logits, Mixture(greedy=1.0)), what)
        cdf, points = self._cdf.to(noise.device), how_long.double().contiguous()
        duration = torch.searchsorted(cdf, points, right=True) + 1
        exploring = whether < epsilon

        held = self._action.to(logits.device).view(batch)
        left = self._remaining.to(logits.device).view(batch)
        held = held.clamp(max=logits.shape[-1] - 1)
        allowed = logits.gather(-1, held.unsqueeze(-1)).squeeze(-1) != -torch.inf
        running = (left > 0) & allowed & ~_starts(tensordict, batch)
        action = torch.where(running, held, torch.where(exploring, uniform, greedy))
        drawn = torch.where(exploring, duration.clamp(max=self.max_duration) - 1, 0)
        self._remaining = torch.where(running, left - 1, drawn).reshape(-1)
        self._action = action.reshape(-1)
        return action, None

    def get_extra_state(self) -> dict[str, Any]:
        """The state for ``state_dict``, including running repetitions."""
        repetition = {"remaining": self._remaining.clone(), "action": self._action.clone()}
        return {**super().get_extra_state(), **repetition}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore the state from ``get_extra_state``."""
        super().set_extra_state(state)
        self._remaining, self._action = state["remaining"].clone(), state["action"].clone()


def _starts(tensordict: TensorDictBase, batch: torch.Size) -> Tensor:
    """Whether a frame is marked as the first of its episode [*batch]."""
    first = torch.zeros(batch, dtype=torch.bool, device=tensordict.device)
    if (is_init := tensordict.get("is_init", None)) is not None:
        first = first | is_init.reshape(batch)
    if (step_count := tensordict.get("step_count", None)) is not None:
        first = first | (step_count.reshape(batch) == 0)
    return first
