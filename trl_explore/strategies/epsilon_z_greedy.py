"""ε-greedy with repeated random actions."""

from __future__ import annotations

from typing import Unpack

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from trl_explore.checks import check_integer, check_number
from trl_explore.strategies.discrete import Options, Strategy
from trl_explore.strategies.frames import FirstFrames, rows
from trl_explore.strategies.mixture import Mixture, mixture_probs
from trl_explore.strategies.schedules import Parameter


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
    repetition of a lane; for collectors that do not call it, so does the first frame of an episode,
    see ``strategies.frames``.

    Args:
        epsilon: ε in [0, 1], a number, one number per trial, or a schedule.
        mu: the exponent, > 1; smaller values give longer repetitions.
        max_duration: N >= 1.
        is_init_key: the entry that marks the first frame of an episode.
        options: the arguments of ``Strategy``.

    Raises:
        ValueError: if an argument is out of range.

    Example:
        >>> from tensordict import TensorDict
        >>> strategy = EpsilonZGreedy(1.0, noise_key="noise")
        >>> noise = torch.tensor([[0.0, 0.9, 0.7]])  # explore; action 1; P(n <= 1) = 0.608 < 0.7
        >>> logits = torch.tensor([[5.0, 0.0]])
        >>> frame = TensorDict({"logits": logits, "noise": noise, "is_init": [[False]]}, [1])
        >>> first = int(strategy(frame)["action"])
        >>> frame["noise"] = torch.zeros(1, 3)
        >>> first, int(strategy(frame)["action"]), int(strategy(frame)["action"])
        (1, 1, 0)
    """

    exact = False
    noise_size = 3
    epsilon: Tensor
    _cdf: Tensor

    def __init__(
        self,
        epsilon: Parameter = 0.1,
        mu: float = 2.0,
        max_duration: int = 10_000,
        is_init_key: NestedKey = "is_init",
        **options: Unpack[Options],
    ) -> None:
        super().__init__(**options)
        self.follow("epsilon", epsilon, 0, 1)
        self.mu = check_number("mu", mu, 1, low_open=True)
        self.max_duration = check_integer("max_duration", max_duration, 1, 10**7)
        weights = np.arange(1, self.max_duration + 1, dtype=np.float64) ** -self.mu
        cdf = torch.from_numpy(np.cumsum(weights) / np.sum(weights))
        self.register_buffer("_cdf", cdf, persistent=False)
        self._first = FirstFrames(str(type(self).__name__), is_init_key)
        # The repetitions belong to the lanes of this process: they are no buffers, which TorchRL
        # copies from process to process.
        self._remaining = self._action = torch.zeros(0, dtype=torch.int64)

    def begin(self, active: NDArray[np.bool_], episodes: NDArray[np.int64]) -> None:
        """End the repetitions of the active trials."""
        self._first.begun = True
        if len(self._remaining) == len(active):
            self._remaining = self._remaining.clone()
            self._remaining[torch.from_numpy(active)] = 0

    def probs(self, logits: Tensor, trial: Tensor | None = None) -> Tensor:
        """ε-greedy [*batch, n_actions]: μ if no repetition is running."""
        epsilon = rows(self.epsilon, trial, logits)
        return mixture_probs(logits, Mixture(greedy=1 - epsilon, uniform=epsilon))

    def explore(
        self, tensordict: TensorDictBase, logits: Tensor, noise: Tensor
    ) -> tuple[Tensor, None]:
        """Continue a repetition, or draw; ``noise`` decides whether, which action and how long."""
        logits = self._split(logits)
        batch = logits.shape[:-1]
        if self._remaining.shape != batch or self._remaining.device != logits.device:
            self._remaining = torch.zeros(batch, dtype=torch.int64, device=logits.device)
            self._action = torch.zeros_like(self._remaining)
        epsilon = rows(self.epsilon, self._trial(tensordict), logits)
        epsilon = torch.as_tensor(epsilon, dtype=torch.float64, device=logits.device)
        epsilon = epsilon.expand(*batch, 1).squeeze(-1)
        whether, what, how_long = noise.unbind(-1)
        uniform, greedy = (
            self._draw(mixture_probs(logits, mixture), what, logits, tensordict)[0]
            for mixture in (Mixture(uniform=1.0), Mixture(greedy=1.0))
        )
        duration = torch.searchsorted(self._cdf, how_long.contiguous(), right=True) + 1
        exploring = whether < epsilon

        held = self._action.clamp(max=logits.shape[-1] - 1)
        allowed = logits.gather(-1, held.unsqueeze(-1)).squeeze(-1) != -torch.inf
        first = self._first(tensordict, batch)
        running = (self._remaining > 0) & allowed & ~first
        drawn = torch.where(exploring, uniform, greedy)
        action = torch.where(running, held, drawn)
        left = torch.where(exploring, duration.clamp(max=self.max_duration) - 1, 0)
        self._remaining = torch.where(running, self._remaining - 1, left)
        self._action = action
        return action, None
