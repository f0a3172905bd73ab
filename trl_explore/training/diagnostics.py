"""Diagnostics of a trial: randomness and distance of π and μ, coverage, gradient norm."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor

from trl_explore.objectives.episodes import Episodes
from trl_explore.policies.actor import SoftmaxCategorical, frame_distribution
from trl_explore.strategies import BaseStrategy, Strategy
from trl_explore.training.diagnostic_quantities import DIAGNOSTIC_COLUMNS as COLUMNS
from trl_explore.training.snapshots import Visits

CELL = 0.1
"""The width of the cells of a continuous observation, in its own units."""


class Diagnostics:
    """Quantities, per iteration and trial, that explain how a trial learns.

    Over the n frames of a trial's iteration, with ρ = π(a|s) / μ(a|s) of the actions taken:

        entropy_policy         mean of H(π(·|s)) [nats]
        entropy_behaviour      mean of H(μ(·|s)) [nats]
        kl                     mean of KL(μ(·|s) ‖ π(·|s)) [nats]
        ratio_mean             mean of ρ; its expectation is 1 if μ covers π
        effective_sample_size  (Σ ρ)² / (n Σ ρ²), in (0, 1] (Kong 1992)
        exploratory            share of actions that are not greedy
        greedy_share           share of frames with the most frequent greedy action: 1 is lock-in,
                               the same greedy action in every state visited
        coverage               number of cells of the observation space visited so far; a cell is
                               a one-hot state, or a cube of width 0.1
        gradient_norm          ‖∂L/∂θ‖₂ of the trial's policy parameters

    For continuous actions the entropy of μ is the mean of −log μ(a|s), and the KL divergence that
    of log μ(a|s) − log π(a|s); the greedy action is the mean of π, and greedy_share is undefined.

    Undefined quantities are nan: entropy_behaviour and kl if the probabilities of all actions are
    not known exactly, or if an iteration has several episodes and μ changes with each of them
    (``ParameterNoise``); the ratios if there is no "action_log_prob".

    Args:
        actor: the target policy.
        strategy: the behaviour policy.
        trials: the number of trials.
        parameters: the policy's parameters, each with the trials as dimension 0.
        visits: counts where the trials have been; None: not counted.
    """

    def __init__(
        self,
        actor: ProbabilisticActor,
        strategy: BaseStrategy,
        trials: int,
        parameters: Iterable[nn.Parameter],
        visits: Visits | None = None,
    ) -> None:
        self.actor, self.strategy, self.trials = actor, strategy, trials
        self.parameters, self.visits = list(parameters), visits
        self.visited: list[set[bytes]] = [set() for _ in range(trials)]
        self._rows: list[NDArray[np.float32]] = []

    @torch.no_grad()
    def record(self, data: TensorDictBase, active: NDArray[np.bool_]) -> None:
        """Record an iteration; call it after the loss's backward pass, before the update.

        Args:
            data: the frames of the iteration.
            active: [trials] bool, the trials that have frames.
        """
        if self.visits is not None:
            self.visits.record(data)
        trial, done = data.get("trial"), data.get(("next", "done")).squeeze(-1)
        reward = data.get(("next", "reward")).squeeze(-1)
        episodes = Episodes(data, reward, done, trial, self.trials, 1.0)
        columns = {name: torch.full((self.trials,), torch.nan) for name in COLUMNS}
        if self.strategy.actions == "continuous":
            columns |= self._densities(episodes)
        else:
            columns |= self._distributions(episodes) | self._greedy(episodes)
        columns |= {"coverage": self._coverage(episodes), "gradient_norm": self._norms()}
        which = torch.from_numpy(active)
        table = torch.stack([columns[name].double()[which] for name in COLUMNS], 1)
        self._rows.append(table.numpy().astype(np.float32))

    def _densities(self, episodes: Episodes) -> dict[str, Tensor]:
        """The diagnostics of continuous actions."""
        data, action = episodes.tensordict, episodes.tensordict.get("action")
        pi: Any = frame_distribution(self.actor, data)
        log_pi, log_mu = pi.log_prob(action).double(), data.get("action_log_prob", None)
        found = {
            "entropy_policy": episodes.trial_mean(pi.entropy()),
            "exploratory": episodes.trial_mean((action != pi.mean).any(-1).to(action.dtype)),
        }
        if log_mu is None:
            return found
        log_ratio = log_pi - log_mu.double()
        return found | {
            "entropy_behaviour": episodes.trial_mean(-log_mu),
            "kl": episodes.trial_mean(-log_ratio),
            **_ratios(episodes, log_ratio),
        }

    def _distributions(self, episodes: Episodes) -> dict[str, Tensor]:
        assert isinstance(self.strategy, Strategy)
        data, found = episodes.tensordict, {}
        pi: Any = frame_distribution(self.actor, data)
        log_pi = pi.logits
        found["entropy_policy"] = episodes.trial_mean(_entropy(log_pi))
        behaviour = data.get("action_log_prob", None)
        if behaviour is None:
            return found
        log_prob = log_pi.gather(-1, data.get("action").unsqueeze(-1)).squeeze(-1)
        found |= _ratios(episodes, log_prob.double() - behaviour.double())
        if self.strategy.per_episode and bool((episodes.episodes_of_trial > 1).any()):
            return found
        logits = self.strategy.preferences(data, log_pi)
        log_mu = self.strategy.probs(logits, episodes.trial).log()
        found["entropy_behaviour"] = episodes.trial_mean(_entropy(log_mu))
        terms = torch.where(log_mu == -torch.inf, 0.0, log_mu.exp() * (log_mu - log_pi))
        found["kl"] = episodes.trial_mean(terms.sum(-1))
        return found

    def _greedy(self, episodes: Episodes) -> dict[str, Tensor]:
        data = episodes.tensordict
        logits = cast(SoftmaxCategorical, frame_distribution(self.actor, data)).logits
        largest = logits.amax(-1)
        taken = logits.gather(-1, data.get("action").unsqueeze(-1)).squeeze(-1)
        chosen = torch.nn.functional.one_hot(logits.argmax(-1), logits.shape[-1]).to(logits.dtype)
        shares = [episodes.trial_mean(column) for column in chosen.unbind(-1)]
        return {
            "exploratory": episodes.trial_mean((taken < largest).to(logits.dtype)),
            "greedy_share": torch.stack(shares).amax(0),
        }

    def _coverage(self, episodes: Episodes) -> Tensor:
        cells = np.floor(episodes.tensordict.get("observation").numpy() / CELL).astype(np.int32)
        trial = episodes.trial.numpy()
        edges = np.flatnonzero(np.diff(trial)) + 1
        for part, rows in zip(np.split(trial, edges), np.split(cells, edges), strict=True):
            if len(part):
                text, size = rows.tobytes(), rows[0].nbytes
                self.visited[part[0]].update(text[i : i + size] for i in range(0, len(text), size))
        return torch.tensor([len(cells) for cells in self.visited])

    def _norms(self) -> Tensor:
        squares = torch.zeros(self.trials, dtype=torch.float64)
        for parameter in self.parameters:
            if parameter.grad is not None:
                rows = parameter.grad.reshape(self.trials, -1).double()
                squares += torch.stack([(column**2) for column in rows.unbind(1)]).sum(0)
        return squares.sqrt()

    def columns(self) -> dict[str, NDArray[np.float32]]:
        """Every quantity, one entry per iteration and active trial, ordered by both."""
        return dict(zip(COLUMNS, self.history()["rows"].T, strict=True))

    def iterations(self) -> NDArray[np.int64]:
        """The iteration of every entry of ``columns``, from 1."""
        counts = self.history()["counts"]
        return np.repeat(np.arange(1, len(counts) + 1), counts)

    def state_dict(self) -> dict[str, Any]:
        """The visited cells and the visits; ``history`` has the rest."""
        sizes = [len(cells) for cells in self.visited]
        cells = b"".join(cell for cells in self.visited for cell in sorted(cells))
        return {
            "cells": np.frombuffer(cells, dtype=np.int32).copy(),
            "sizes": np.array(sizes, dtype=np.int64),
            "visits": None if self.visits is None else self.visits.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a ``state_dict``."""
        if self.visits is not None:
            self.visits.load_state_dict(state["visits"])
        sizes = np.asarray(state["sizes"])
        cells = np.asarray(state["cells"]).reshape(max(1, int(sizes.sum())), -1)
        parts = np.split(cells, np.cumsum(sizes)[:-1])
        self.visited = [
            {row.tobytes() for row in part[:size]}
            for part, size in zip(parts, sizes.tolist(), strict=True)
        ]

    def history(self, since: int = 0, until: int | None = None) -> dict[str, NDArray[Any]]:
        """The record of iterations ``since`` + 1 to ``until``; None means the last."""
        part = self._rows[since:until]
        return {
            "rows": np.concatenate([np.empty((0, len(COLUMNS)), np.float32), *part]),
            "counts": np.array([len(rows) for rows in part], dtype=np.int64),
        }

    def load_history(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Append the output of ``history``."""
        if len(counts := columns["counts"]):
            self._rows += np.split(columns["rows"], np.cumsum(counts)[:-1])


def _ratios(episodes: Episodes, log_ratio: Tensor) -> dict[str, Tensor]:
    """The diagnostics of the ratios, from log ρ [frames]."""
    ratio = log_ratio.exp()
    mean = episodes.trial_mean(ratio)
    size = mean**2 / episodes.trial_mean(ratio**2)
    return {"ratio_mean": mean, "effective_sample_size": size}


def _entropy(log_prob: Tensor) -> Tensor:
    """Entropy [frames] of log-probabilities [frames, n_actions], with 0 · log 0 = 0."""
    return -torch.where(log_prob == -torch.inf, 0.0, log_prob.exp() * log_prob).sum(-1)
