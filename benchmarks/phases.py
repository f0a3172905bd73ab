"""The time of each part of an iteration. The parts of the trainer are wrapped from outside."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

from runs import CAP, Run, build, train

from trl_explore.training.shards import Shards
from trl_explore.training.trainer import Trainer

PHASES = ("collect", "loss", "optimiser", "check", "record")
"""The loss with its gradient; the check is whether loss and weights are finite."""


class Clock:
    """Seconds spent in each phase."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = dict.fromkeys(PHASES, 0.0)

    def timed(self, phase: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """``function``, with its seconds added to those of ``phase``."""
        clock, seconds = time.perf_counter, self.seconds

        def call(*args: Any, **kwargs: Any) -> Any:
            started = clock()
            result = function(*args, **kwargs)
            seconds[phase] += clock() - started
            return result

        return call


@contextmanager
def wrapped(trainer: Trainer, clock: Clock) -> Iterator[None]:
    """Time the parts of ``trainer`` within this context."""
    parts = (
        (trainer.collector, "collect", "collect"),
        (trainer, "_backward", "loss"),
        (trainer.optimizer, "zero_grad", "optimiser"),
        (trainer.optimizer, "step", "optimiser"),
        (trainer, "_diverged", "check"),
        (trainer.trials, "record", "record"),
    )
    patches = [
        mock.patch.object(target, name, clock.timed(phase, getattr(target, name)))
        for target, name, phase in parts
    ]
    for patch in patches:
        patch.start()
    try:
        yield
    finally:
        for patch in patches:
            patch.stop()


def phases(trials: int, max_iterations: int = CAP) -> dict[str, float]:
    """Microseconds per iteration of a whole softmax run, by phase, with "rest" and "total"."""
    trainer, clock = build("softmax", trials, max_iterations=max_iterations), Clock()
    with wrapped(trainer, clock):
        run: Run = train(Shards([trainer]))
    parts = {name: 1e6 * seconds / run.iterations for name, seconds in clock.seconds.items()}
    total = 1e6 * run.seconds / run.iterations
    return {**parts, "rest": total - sum(parts.values()), "total": total}
