"""The loop: collect one episode of every active trial, update, stop those that are done."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.objectives.common import LossModule

from trl_explore.collectors import EpisodeCollector
from trl_explore.optim import LaneOptimizer
from trl_explore.trials import Trials


class Trainer:
    """Trains all trials of a job, in lockstep: all finish iteration i before any begins i + 1.

    It knows no concrete environment, policy, strategy or loss.

    Args:
        collector: one whole episode of every active trial per call.
        loss: a loss with one value per trial, in "trial_loss", and reduction "sum" or "none".
        optimizer: moves the active trials.
        trials: the record, which decides when a trial stops.
        on_iteration: called after each iteration with the record.

    Raises:
        ValueError: if the loss averages over trials, which would couple them.
    """

    def __init__(
        self,
        collector: EpisodeCollector,
        loss: LossModule,
        optimizer: LaneOptimizer,
        trials: Trials,
        *,
        on_iteration: Callable[[Trials], None] | None = None,
    ) -> None:
        if loss.reduction == "mean":
            raise ValueError("reduction 'mean' couples the trials; allowed here are sum and none")
        self.collector = collector
        self.loss = loss
        self.optimizer = optimizer
        self.trials = trials
        self.on_iteration = on_iteration

    def run(self) -> Trials:
        """Train until every trial has stopped."""
        started = time.perf_counter()
        while self.trials.active.any():
            self._iterate(started)
            if self.on_iteration is not None:
                self.on_iteration(self.trials)
        return self.trials

    def _iterate(self, started: float) -> None:
        active = self.trials.active
        data = self.collector.collect(active)
        scores, frames = outcomes(data)
        trial_loss = self._update(data, active)
        self.collector.strategy.step()
        diverged = self._diverged(trial_loss, active)
        self.trials.record(scores, frames, diverged, time.perf_counter() - started)

    def _update(self, data: TensorDictBase, active: NDArray[np.bool_]) -> torch.Tensor:
        self.optimizer.zero_grad()
        losses = self.loss(data)
        losses["loss_actor"].sum().backward()
        self.optimizer.step(torch.from_numpy(active))
        return losses["trial_loss"]

    def _diverged(self, trial_loss: torch.Tensor, active: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Whether an active trial's loss or one of its weights is not finite [active]."""
        rows = [trial_loss, *(p.detach() for p in self.optimizer.parameters)]
        if np.isfinite(sum(float(tensor.sum()) for tensor in rows)):
            return np.zeros(int(active.sum()), dtype=np.bool_)
        finite = [tensor.reshape(len(tensor), -1).isfinite().all(1) for tensor in rows]
        return ~torch.stack(finite).all(0).numpy()[active]


def outcomes(data: TensorDictBase) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Score and number of frames of every episode in a collector's data, in their order."""
    last = data.get(("next", "done")).squeeze(-1)
    scores = data.get(("next", "episode_reward")).squeeze(-1)[last]
    frames = data.get(("next", "step_count")).squeeze(-1)[last]
    return scores.numpy().astype(np.float64), frames.numpy()
