"""Everything measured about one configuration, as one row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trl_explore.statistics.bootstrap import RESAMPLES, bootstrap, streams
from trl_explore.statistics.estimates import LEVEL, Estimate
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.proportions import pass_rate
from trl_explore.statistics.scores import ScoreSummary, summarise_scores
from trl_explore.statistics.survival import (
    convergence_times,
    expected_running_time,
    kaplan_meier,
    median_time,
    restricted_mean,
)


@dataclass(frozen=True, eq=False)
class Summary:
    """The statistics of one configuration.

    Attributes:
        name: of the configuration.
        experiment: it belongs to.
        strategy: name of the strategy.
        parameters: of the strategy.
        n: number of trials.
        converged: trials that converged.
        diverged: trials that diverged (never converging, in all statistics).
        cap: iterations.
        pass_rate: with Wilson interval.
        median: Kaplan-Meier median of iterations; ``inf``: not reached.
        restricted_mean: E[min(T, cap)], iterations.
        restricted_mean_se: its standard error, iterations; NaN for one trial.
        expected_running_time: iterations per success with restarts; ``inf``: none converged.
        score: the final score's distribution.
        frames_median: median frames to convergence; ``inf``: not reached.
        frames_mean: mean frames until a trial stopped, converged or not, bootstrap interval.
        frames_total: frames of all trials.

    """

    name: str
    experiment: str
    strategy: str
    parameters: Mapping[str, Any]
    n: int
    converged: int
    diverged: int
    cap: int
    pass_rate: Estimate
    median: Estimate
    restricted_mean: float
    restricted_mean_se: float
    expected_running_time: Estimate
    score: ScoreSummary
    frames_median: Estimate
    frames_mean: Estimate
    frames_total: int

    def row(self) -> dict[str, Any]:
        """Flat dictionary for a table; each estimate as ``x``, ``x_low``, ``x_high``."""
        row: dict[str, Any] = {
            key: getattr(self, key)
            for key in ("experiment", "name", "strategy", "n", "converged", "diverged", "cap")
        }
        for key, estimate in {
            "pass_rate": self.pass_rate,
            "median": self.median,
            "restricted_mean": (self.restricted_mean, self.restricted_mean_se),
            "expected_running_time": self.expected_running_time,
            "score_mean": self.score.mean,
            "score_iqm": self.score.iqm,
            "frames_median": self.frames_median,
            "frames_mean": self.frames_mean,
        }.items():
            if isinstance(estimate, Estimate):
                row[key] = estimate.value
                row[f"{key}_low"], row[f"{key}_high"] = estimate.low, estimate.high
            else:
                row[key], row[f"{key}_se"] = estimate
        for p, q in zip(self.score.levels, self.score.quantiles, strict=True):
            row[f"score_q{round(100 * p):02d}"] = float(q)
        return row | {"frames_total": self.frames_total}


def summarise(
    outcomes: Outcomes,
    rng: np.random.Generator,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
) -> Summary:
    """All statistics of one configuration; each is defined where it is computed.

    Args:
        outcomes: the configuration [n_trials].
        rng: source of the bootstraps.
        level: confidence level of every interval.
        resamples: of every bootstrap.

    Raises:
        ValueError: no trials, or an unfinished job (see ``convergence_times``).

    """
    durations, converged = convergence_times(outcomes)
    mean, error = restricted_mean(durations, converged, outcomes.cap)
    frames = [outcomes.frames.astype(np.float64)]
    return Summary(
        name=outcomes.name,
        experiment=outcomes.experiment,
        strategy=outcomes.strategy,
        parameters=outcomes.parameters,
        n=len(outcomes),
        converged=int(converged.sum()),
        diverged=int(np.count_nonzero(outcomes.status == "diverged")),
        cap=outcomes.cap,
        pass_rate=pass_rate(int(converged.sum()), len(outcomes), level=level),
        median=median_time(kaplan_meier(durations, converged, level=level)),
        restricted_mean=mean,
        restricted_mean_se=error,
        expected_running_time=expected_running_time(
            durations, converged, rng, level=level, resamples=resamples
        ),
        score=summarise_scores(outcomes.score, rng, level=level, resamples=resamples),
        frames_median=median_time(
            kaplan_meier(*convergence_times(outcomes, "frames"), level=level)
        ),
        frames_mean=bootstrap(
            lambda x: x.mean(axis=-1), frames, rng, level=level, resamples=resamples
        ),
        frames_total=int(outcomes.frames.sum()),
    )


def summarise_all(
    configurations: Sequence[Outcomes],
    rng: np.random.Generator,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
) -> list[Summary]:
    """One summary per configuration; a row does not depend on which other rows there are."""
    rngs = streams(rng, [f"{c.experiment}/{c.name}" for c in configurations])
    return [
        summarise(c, rngs[f"{c.experiment}/{c.name}"], level=level, resamples=resamples)
        for c in configurations
    ]
