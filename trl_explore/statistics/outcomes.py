"""The results of one configuration, one entry per trial; its times to convergence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

STATUSES = ("converged", "capped", "diverged")
MEASURES = ("passed", "learned")
CUT_OFF = 0.1
"""If the other rule stopped more than this share of trials, a measure cannot be judged."""
PER_TRIAL = (
    "trial", "seed", "iterations", "converged", "score", "frames", "seconds", "status",
    "passed", "iterations_to_pass", "frames_to_pass",
    "learned", "iterations_to_learn", "frames_to_learn", "learned_score",
)  # fmt: skip
"""The fields of ``Outcomes`` with one entry per trial; the last seven may be None."""


@dataclass(frozen=True, eq=False)
class Outcomes:
    """The trials of one job, in the order of their trial index.

    Every array has shape [n_trials]. A trial with status ``capped`` is right-censored at
    ``iterations``. A trial with status ``diverged`` never converges, so it counts as censored at
    the cap, regardless of the iteration in which it stopped.

    What stopped a trial (``converged``) depends on ``stop_on``. What it did while it explored
    (``passed``) and what it learned (``learned``) are recorded too, or are None;
    :func:`judged` turns one of the two into ``converged``.

    Attributes:
        name: the name of the job folder, unique within a sweep.
        experiment: the sweep it belongs to.
        config: the whole resolved configuration of the job.
        cap: ``max_iterations``.
        threshold: the score above which a trial has passed, or learned.
        window: the number of episodes that the final score averages over.
        iterations: until the trial stopped.
        score: final score.
        frames: environment steps until the trial stopped.
        seconds: wall time from the start of the trial's batch until it stopped.
        status: ``converged``, ``capped`` or ``diverged``; in the result of :func:`judged` also
            ``stopped``, by the rule of the other measure.
        passed: whether the mean of a full window of training scores ever exceeded the threshold.
        iterations_to_pass, frames_to_pass: until then, or all that were trained.
        learned: whether the trial has learned (see ``statistics.evaluations``).
        iterations_to_learn: the iteration of the evaluation at which it had learned (0: before its
            first update), or of the last one.
        frames_to_learn: training frames until then.
        learned_score: mean score of the final policy without the strategy, on episodes of its own.
        measure: ``passed`` or ``learned`` if :func:`judged` made these outcomes, else empty.
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
    passed: NDArray[np.bool_] | None = None
    iterations_to_pass: NDArray[np.int64] | None = None
    frames_to_pass: NDArray[np.int64] | None = None
    learned: NDArray[np.bool_] | None = None
    iterations_to_learn: NDArray[np.int64] | None = None
    frames_to_learn: NDArray[np.int64] | None = None
    learned_score: NDArray[np.float64] | None = None
    measure: str = ""

    def __post_init__(self) -> None:
        # Files without these columns: with stop_on=training, a trial stopped when it passed.
        if self.passed is None and self.config.get("stop_on", "training") == "training":
            for name, value in (
                ("passed", self.converged),
                ("iterations_to_pass", self.iterations),
                ("frames_to_pass", self.frames),
            ):
                object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.trial)

    @property
    def durations(self) -> NDArray[np.int64]:
        """Iterations to convergence or censoring [n_trials]; the cap for diverged trials."""
        return np.where(self.status == "diverged", self.cap, self.iterations)

    @property
    def first_index(self) -> dict[int, int]:
        """Trial -> the first index in the arrays that has it."""
        return {int(t): i for i, t in reversed(list(enumerate(self.trial)))}

    @property
    def judged_by(self) -> str:
        """The scores that decide convergence: ``training``, or a description of the evaluations."""
        rule = self.measure or self.config.get("stop_on", "training")
        if rule in ("training", "passed"):
            return "training"
        every, count = self.config.get("evaluate_every"), self.config.get("evaluate_episodes", 1)
        rhythm = f"{count} every {every} iterations" if isinstance(every, int) else f"{count} each"
        return f"{rule} ({rhythm})"

    @property
    def cut_short(self) -> bool:
        """Whether the cap comes before the first full window, so that no trial could pass."""
        per_update = self.config.get("episodes_per_update", 1)
        if self.judged_by != "training" or not isinstance(per_update, int):
            return False
        return self.cap * per_update < self.window


def lower_median(times: NDArray[np.int64], event: NDArray[np.bool_]) -> float:
    """The median of the times [n] to an event; ``inf`` where it was not seen.

    Of an even number of trials, the smaller of the two middle values.
    """
    return float(np.sort(np.where(event, times, np.inf))[(len(event) - 1) // 2])


def judged(outcomes: Outcomes, measure: str) -> Outcomes:
    """The outcomes with ``converged``, ``iterations``, ``frames`` and ``score`` of one measure.

    With ``passed`` a trial is judged by its training scores, with ``learned`` by what its policy
    scores without the strategy. Every statistic of the package then applies to the measure.

    A trial for which the event was not seen is right-censored: at the cap if it was trained to the
    cap or diverged. A trial that the rule of the *other* measure stopped earlier has status
    ``stopped`` and is censored where it stopped. Such censoring depends on how well the trial does,
    so the Kaplan-Meier curve, the restricted mean and the paired tests, which take a censored time
    as it is, are only approximate then. Few such trials do not matter; above a share of
    ``CUT_OFF`` this is an error. With ``stop_on=both`` or ``never`` there is none.

    A trial that had learned before its first update counts with 1 iteration, because durations are
    positive. Seconds are those until the trial stopped.

    Args:
        outcomes: one configuration, as read from its files.
        measure: ``passed`` or ``learned``.

    Raises:
        ValueError: another measure; a job without evaluations; too many trials stopped by the
            other rule.
    """
    if measure not in MEASURES:
        raise ValueError(f"measure={measure!r}: {' or '.join(MEASURES)} is possible")
    if measure == "passed":
        event, iterations, frames = (
            outcomes.passed, outcomes.iterations_to_pass, outcomes.frames_to_pass,
        )  # fmt: skip
        score, missing = outcomes.score, "does not record which trials passed"
    else:
        event, iterations, frames = (
            outcomes.learned, outcomes.iterations_to_learn, outcomes.frames_to_learn,
        )  # fmt: skip
        score, missing = outcomes.learned_score, "has no evaluations (evaluate_every=auto)"
    if event is None or iterations is None or frames is None or score is None:
        raise ValueError(f"{outcomes.name} {missing}: what was {measure} is unknown")
    diverged = (outcomes.status == "diverged") & ~event
    stopped = ~event & ~diverged & (outcomes.iterations < outcomes.cap)
    if len(outcomes) and stopped.mean() > CUT_OFF:
        raise ValueError(
            f"{outcomes.name}: {stopped.sum()} of {len(outcomes)} trials had stopped before it was"
            f" known when they {measure}; stop_on=both or never trains them further"
        )
    status = np.select([event, diverged, stopped], ["converged", "diverged", "stopped"], "capped")
    return replace(
        outcomes,
        converged=event,
        iterations=np.where(event, np.maximum(iterations, 1), outcomes.iterations),
        frames=np.where(event, np.maximum(frames, 1), outcomes.frames),
        score=score,
        status=status,
        measure=measure,
    )


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
    whole = (durations == outcomes.cap) | (outcomes.status == "stopped")
    wrong = np.where(converged, durations > outcomes.cap, ~whole)
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
