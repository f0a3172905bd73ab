"""What one configuration measured: one entry per trial, as plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

STATUSES = ("converged", "capped", "diverged")


@dataclass(frozen=True, eq=False)
class Outcomes:
    """The trials of one job, in the order of their trial index.

    Every array has shape [n_trials]. A trial with status ``capped`` is right-censored at
    ``iterations``; one with status ``diverged`` never converges, so that it counts as censored
    at the cap, whatever the iteration in which it stopped.

    Attributes:
        name: the name of the job folder, unique within a sweep.
        experiment: the sweep it belongs to (``thesis``, ``epsilon_grid``, ...).
        strategy: the name of the strategy (``softmax``, ``epsilon_greedy``, ...).
        parameters: the parameters of the strategy (``{"epsilon": 0.3}``).
        config: the whole resolved configuration of the job.
        cap: ``max_iterations`` [iterations].
        threshold: the final score above which a trial has converged.
        window: the number of episodes that the final score averages over.
        trial: trial index, int64.
        seed: seed of the job, int64.
        iterations: number of iterations until the trial stopped, int64.
        converged: bool.
        score: final score, float64.
        frames: environment steps until the trial stopped, int64.
        seconds: wall time from the start of the trial's batch until it stopped, float64.
        status: ``converged``, ``capped`` or ``diverged``.

    """

    name: str
    experiment: str
    strategy: str
    parameters: Mapping[str, Any]
    config: Mapping[str, Any]
    cap: int
    threshold: float
    window: int
    trial: NDArray[np.int64]
    seed: NDArray[np.int64]
    iterations: NDArray[np.int64]
    converged: NDArray[np.bool_]
    score: NDArray[np.float64]
    frames: NDArray[np.int64]
    seconds: NDArray[np.float64]
    status: NDArray[np.str_]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.trial)

    @property
    def durations(self) -> NDArray[np.int64]:
        """Iterations to convergence, or to censoring [n_trials]: a diverged trial at the cap."""
        return np.where(self.status == "diverged", self.cap, self.iterations)

    @property
    def judged_by(self) -> str:
        """Which scores decide when a trial has converged: ``training``, or which evaluations."""
        if self.config.get("stop_on", "training") == "training":
            return "training"
        every, count = self.config.get("evaluate_every"), self.config.get("evaluate_episodes", 1)
        return f"{self.config['stop_on']} ({count} every {every} iterations)"

    @property
    def cut_short(self) -> bool:
        """Whether the cap comes before the first full window, so that no trial could converge."""
        per_update = self.config.get("episodes_per_update", 1)
        if self.judged_by != "training" or not isinstance(per_update, int):
            return False
        return self.cap * per_update < self.window
