"""The results of one configuration, one entry per trial; its times to convergence."""

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
    ``iterations``. A trial with status ``diverged`` never converges, so it counts as censored at
    the cap, regardless of the iteration in which it stopped.

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
        """Iterations to convergence or censoring [n_trials]; the cap for diverged trials."""
        return np.where(self.status == "diverged", self.cap, self.iterations)

    @property
    def judged_by(self) -> str:
        """The scores that decide convergence: ``training``, or a description of the evaluations."""
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


def convergence_times(
    outcomes: Outcomes, unit: str = "iterations"
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Durations and event indicators of a configuration, ready for :func:`kaplan_meier`.

    In iterations, a trial that did not converge is censored at the cap. In frames, trials reach
    the cap at different times, and trials with low scores reach it early. Censoring there would
    be informative, and Kaplan-Meier too optimistic. Failed trials therefore stay at risk until the
    largest number of frames of any trial: Ŝ is then one minus the cumulative incidence of
    convergence, with stopping at the cap as a competing event (Aalen-Johansen).

    Args:
        outcomes: one configuration.
        unit: ``iterations`` or ``frames``.

    Returns:
        durations [n] in the unit, converged [n].

    Raises:
        ValueError: an unknown unit; no trials; a trial that converged after the cap, or stopped
            before it without converging or diverging (unfinished job).

    Source: Putter, Fiocco & Geskus, Statistics in Medicine 26 (2007), §3.

    """
    if unit not in ("iterations", "frames"):
        raise ValueError(f"unit={unit!r}: iterations or frames are possible")
    if len(outcomes) == 0:
        raise ValueError(f"{outcomes.name}: a configuration without trials")
    converged = np.asarray(outcomes.converged, dtype=bool)
    durations = outcomes.durations.astype(np.float64)
    wrong = np.where(converged, durations > outcomes.cap, durations != outcomes.cap)
    if wrong.any():
        i = int(np.argmax(wrong))
        how = "converged" if converged[i] else "stopped unconverged"
        raise ValueError(
            f"{outcomes.name}: trial {outcomes.trial[i]} {how} after {durations[i]:.0f} iterations,"
            f" which a finished job with cap {outcomes.cap} cannot contain"
        )
    if unit == "frames":
        frames = outcomes.frames.astype(np.float64)
        durations = np.where(converged, frames, frames.max())
    return durations, converged
