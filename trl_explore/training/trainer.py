"""The training loop: collect an episode of every active trial, update, apply the stopping rule."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase

from trl_explore.checks import holds
from trl_explore.collectors import EpisodeCollector, Rollout
from trl_explore.numerics.compiled.cache import clock
from trl_explore.strategies import BaseStrategy
from trl_explore.strategies.parameters import advance
from trl_explore.training.diagnostics import Diagnostics
from trl_explore.training.evaluation import Evaluator
from trl_explore.training.intrinsic import CountReward
from trl_explore.training.optimizers import TrialOptimizer, Views, all_finite
from trl_explore.training.snapshots import Snapshots
from trl_explore.training.trials import Trials

PARTS = (
    "collector", "loss", "optimizer", "trials", "evaluator", "diagnostics", "intrinsic",
    "snapshots",
)  # fmt: skip
"""The attributes of the trainer that have a state."""
STEP = BaseStrategy.step
"""The step of a strategy that overrides none; a function put in its place later is called."""


class TrialLoss(Protocol):
    """The interface of a loss that the trainer uses."""

    reduction: str

    def backward(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Add the losses' gradients to those of the parameters; returns each trial's loss."""
        ...

    def step(self, tensordict: TensorDictBase) -> None:
        """Learn from the data of an iteration, after its update."""
        ...


class Trainer:
    """Trains trials in lockstep: all finish iteration i before any begins i + 1.

    It depends on no concrete environment, policy, strategy or loss.

    Args:
        collector: collects whole episodes of every active trial.
        loss: a loss with one value per trial, in "trial_loss", and reduction "sum" or "none".
        optimizer: updates the active trials.
        trials: the record with the stopping rule.
        evaluator: plays the policy without exploration, and decides when a trial has learned.
        diagnostics: records quantities that explain how a trial learns.
        intrinsic: adds an intrinsic reward to the frames for the loss; None: none.
        snapshots: keeps the weights after some iterations.
        on_iteration: called after each iteration with the record.

    Raises:
        ValueError: if the loss averages over trials, which would couple them, or if trials stop
            on what they learned and there is no evaluator.
    """

    def __init__(
        self,
        collector: EpisodeCollector,
        loss: TrialLoss,
        optimizer: TrialOptimizer,
        trials: Trials,
        *,
        evaluator: Evaluator | None = None,
        diagnostics: Diagnostics | None = None,
        intrinsic: CountReward | None = None,
        snapshots: Snapshots | None = None,
        on_iteration: Callable[[Trials], None] | None = None,
    ) -> None:
        if loss.reduction == "mean":
            raise ValueError(
                "loss: reduction must be 'sum' or 'none', got 'mean', which couples the trials"
            )
        if trials.stop_on in ("learned", "both") and evaluator is None:
            raise ValueError(
                f"stop_on={trials.stop_on} needs evaluations: evaluate_every=auto where there is "
                "a compiled kernel, or a number"
            )
        self.collector = collector
        self.loss = loss
        self.optimizer = optimizer
        self.trials = trials
        self.evaluator = evaluator
        self.diagnostics = diagnostics
        self.intrinsic = intrinsic
        self.snapshots = snapshots
        self.on_iteration = on_iteration
        self._weights = Views(optimizer.parameters)
        self._choose_readers()
        self.seconds = 0.0
        """Wall time of training so far, without compilation and evaluations; includes the time
        before an interruption [s]."""
        self.evaluating = 0.0
        """Wall time of evaluations since the trainer was built, without compilation [s]."""
        parts: dict[str, Any] = {name: getattr(self, name) for name in PARTS}
        self.parts = {name: part for name, part in parts.items() if part is not None}
        """All parts with a state, by name."""

    def run(self, stopped: Callable[[], bool] = lambda: False) -> Trials:
        """Train until every trial has stopped, or ``stopped()`` is true between iterations."""
        self._choose_readers()
        offset = self.seconds - clock() + self.evaluating  # seconds = offset + clock - evaluating
        if self.trials.iteration == 0:
            self._evaluate(0, self.trials.active, self.trials.frames)
            self._keep(0)
        while np.count_nonzero(self.trials.active) and not stopped():
            self._iterate(offset)
            self.seconds = offset + clock() - self.evaluating
            if self.on_iteration is not None:
                self.on_iteration(self.trials)
        if self.evaluator is not None and not self.trials.active.any():
            with self._evaluation():
                self.evaluator.finish(
                    self.trials.iterations, self.trials.frames, self.trials.status == "diverged"
                )
        return self.trials

    def _choose_readers(self) -> None:
        """Decide whether loss and strategy read frames; ``run`` asks again when it begins."""
        reader = getattr(self.loss, "array_backward", None) if self.intrinsic is None else None
        self._arrays_backward = None if reader is None else reader()
        strategy = self.collector.strategy
        plain = holds(strategy, "learns_from_data", ["step"]) and not strategy.learns_from_data
        self._strategy_reads = not plain or strategy.frames.ndim > 0
        self._own_step = getattr(strategy.step, "__func__", None) is not STEP

    @contextmanager
    def _evaluation(self) -> Iterator[None]:
        """Count the time as that of evaluation."""
        started = clock()
        yield
        self.evaluating += clock() - started

    @property
    def parallel(self) -> bool:
        """Whether trainers in several threads run at the same time."""
        evaluates = self.evaluator is None or self.evaluator.collector.parallel
        return self.collector.parallel and evaluates

    def close(self) -> None:
        """Close the environments and free the memory for frames."""
        self.collector.shutdown()
        if self.evaluator is not None:
            self.evaluator.collector.shutdown()

    def state_dict(self) -> dict[str, Any]:
        """The state of every part between two iterations, without what ``history`` has.

        Random streams have no state: seed, trial and episode determine an episode's numbers.
        """
        parts = {name: part.state_dict() for name, part in self.parts.items()}
        return {"seconds": self.seconds, "parts": parts}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a ``state_dict``; load its history first."""
        for name, part in self.parts.items():
            part.load_state_dict(state["parts"][name])
        self.seconds = float(state["seconds"])

    def history(self, since: int = 0, until: int | None = None) -> dict[str, NDArray[Any]]:
        """The parts' records of iterations ``since`` + 1 to ``until``; None means the last."""
        return {
            f"{name}.{column}": values
            for name, part in self.parts.items()
            if hasattr(part, "history")
            for column, values in part.history(since, until).items()
        }

    def load_history(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Append the output of ``history``."""
        for name, part in self.parts.items():
            if hasattr(part, "load_history"):
                own = [column for column in columns if column.startswith(f"{name}.")]
                part.load_history({c.removeprefix(f"{name}."): columns[c] for c in own})

    def _iterate(self, offset: float) -> None:
        active = self.trials.active
        self.optimizer.zero_grad()
        rollout = self.collector.collect(active)
        scores, lengths = rollout.score, rollout.length
        if self.intrinsic is not None:
            self.intrinsic(rollout.frames)
        trial_loss = self._backward(rollout)
        if self.diagnostics is not None:
            self.diagnostics.record(rollout.frames, active)
        self.optimizer.step(torch.from_numpy(active))
        self._learn(rollout)
        diverged = self._diverged(trial_loss, active)
        seconds = offset + clock() - self.evaluating
        learned, iteration = None, self.trials.iteration + 1
        if self.evaluator is not None:
            learned = self.evaluator.learned
            if self.evaluator.is_due(iteration):
                sound, so_far = active.copy(), self.trials.frames.copy()
                sound[active] = ~diverged
                so_far[active] += lengths.reshape(len(lengths), -1).sum(1)
                self._evaluate(iteration, sound, so_far)
        self.trials.record(scores, lengths, diverged, seconds, learned)
        self._keep(iteration)

    def _backward(self, rollout: Rollout) -> torch.Tensor:
        """Add the gradient of the episodes; returns each trial's loss."""
        trial_loss = None
        if self._arrays_backward is not None and rollout.arrays is not None:
            trial_loss = self._arrays_backward(rollout.arrays)
        return self.loss.backward(rollout.frames) if trial_loss is None else trial_loss

    def _learn(self, rollout: Rollout) -> None:
        """Let the loss and the strategy learn from the episodes, after the update."""
        if self._arrays_backward is None:
            self.loss.step(rollout.frames)
        strategy = self.collector.strategy
        if self._strategy_reads:
            strategy.step(rollout.frames)
        elif self._own_step:  # their number is enough
            strategy.step(TensorDict._new_unsafe({}, torch.Size([rollout.count])))
        else:
            advance(strategy, rollout.count)

    def _keep(self, iteration: int) -> None:
        if self.snapshots is not None:
            self.snapshots.record(iteration)

    def _evaluate(
        self, iteration: int, trials: NDArray[np.bool_], frames: NDArray[np.int64]
    ) -> None:
        """Evaluate the trials [n], if there is an evaluator."""
        if self.evaluator is not None and trials.any():
            with self._evaluation():
                self.evaluator.evaluate(iteration, trials, frames)

    def _diverged(self, trial_loss: torch.Tensor, active: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Whether an active trial's loss or one of its weights is not finite [active]."""
        rows = [trial_loss.numpy(), *self._weights()]
        if all(map(all_finite, rows)):
            return np.zeros(np.count_nonzero(active), dtype=np.bool_)
        finite = [np.isfinite(row.reshape(len(row), -1)).all(axis=1) for row in rows]
        return ~np.logical_and.reduce(finite)[active]
