"""All estimates for one configuration; the distribution of its final scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from trl_explore.statistics.bootstrap import RESAMPLES, bootstrap, mean, streams
from trl_explore.statistics.estimates import LEVEL, Estimate, flat, pass_rate
from trl_explore.statistics.outcomes import Outcomes, convergence_times
from trl_explore.statistics.survival import (
    expected_running_time,
    kaplan_meier,
    median_time,
    restricted_mean,
)

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass(frozen=True, eq=False)
class ScoreSummary:
    """Distribution of the final scores of one configuration.

    Attributes:
        n: trials with a finite score.
        missing: trials without a finite score (they diverged before they had one), not included.
        mean: mean with bootstrap interval.
        iqm: interquartile mean with bootstrap interval.
        sd: standard deviation (n - 1); NaN for one trial.
        quantiles: quantiles [5] at the probabilities ``QUANTILES``, by linear interpolation.

    """

    n: int
    missing: int
    mean: Estimate
    iqm: Estimate
    sd: float
    quantiles: NDArray[np.float64]


def interquartile_mean(scores: ArrayLike) -> Any:
    """Mean of the middle half: ⌊n/4⌋ values are removed at each end of the last axis.

    Source: Agarwal et al., Deep RL at the Edge of the Statistical Precipice (2021), §4.3.

    >>> float(interquartile_mean([0.0, 2.0, 4.0, 1000.0]))
    3.0

    """
    return stats.trim_mean(np.asarray(scores, dtype=np.float64), 0.25, axis=-1)


def summarise_scores(
    scores: ArrayLike,
    rng: np.random.Generator,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
) -> ScoreSummary:
    """Mean, interquartile mean and quantiles of final scores [n]; NaN scores are left out.

    >>> summarise_scores([1.0, 2.0, 3.0, 4.0], np.random.default_rng(0)).iqm.value
    2.5
    """
    values = np.asarray(scores, dtype=np.float64)
    finite = values[np.isfinite(values)]
    missing = len(values) - len(finite)
    if len(finite) == 0:
        nothing = Estimate(np.nan, np.nan, np.nan, level)
        return ScoreSummary(0, missing, nothing, nothing, np.nan, np.full(5, np.nan))
    return ScoreSummary(
        n=len(finite),
        missing=missing,
        mean=bootstrap(mean, [finite], rng, level=level, resamples=resamples),
        iqm=bootstrap(interquartile_mean, [finite], rng, level=level, resamples=resamples),
        sd=float(finite.std(ddof=1)) if len(finite) > 1 else np.nan,
        quantiles=np.quantile(finite, QUANTILES),
    )


@dataclass(frozen=True, eq=False)
class Summary:
    """The statistics of one configuration.

    Attributes:
        name: name of the configuration.
        experiment: name of the experiment.
        strategy: name of the strategy.
        parameters: parameters of the strategy.
        n: number of trials.
        converged: number of trials that converged.
        diverged: number of trials that diverged; all statistics count them as never converging.
        cap: maximum number of iterations.
        pass_rate: share of trials that converged, with Wilson interval.
        median: Kaplan-Meier median of iterations; ``inf``: not reached.
        restricted_mean: E[min(T, cap)], iterations.
        restricted_mean_se: its standard error, iterations; NaN for one trial.
        expected_running_time: iterations per success with restarts; ``inf``: none converged.
        score: distribution of the final scores.
        frames_median: median frames to convergence; ``inf``: not reached.
        frames_mean: mean frames until a trial stopped, converged or not, with bootstrap interval.
        frames_total: total frames of all trials.

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
            for key in (
                "experiment", "name", "strategy", "n", "converged", "diverged", "cap", "pass_rate",
                "median", "restricted_mean", "restricted_mean_se", "expected_running_time",
            )
        }  # fmt: skip
        row |= {"score_mean": self.score.mean, "score_iqm": self.score.iqm}
        row |= {"frames_median": self.frames_median, "frames_mean": self.frames_mean}
        for p, q in zip(QUANTILES, self.score.quantiles, strict=True):
            row[f"score_q{round(100 * p):02d}"] = float(q)
        return flat(row) | {"frames_total": self.frames_total}


def summarise(
    outcomes: Outcomes,
    rng: np.random.Generator,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
) -> Summary:
    """All statistics of one configuration; see the functions that compute them.

    Raises:
        ValueError: no trials, or an unfinished job (see ``convergence_times``).

    """
    durations, converged = convergence_times(outcomes)
    restricted, error = restricted_mean(durations, converged, outcomes.cap)
    frames = outcomes.frames.astype(np.float64)
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
        restricted_mean=restricted,
        restricted_mean_se=error,
        expected_running_time=expected_running_time(
            durations, converged, rng, level=level, resamples=resamples
        ),
        score=summarise_scores(outcomes.score, rng, level=level, resamples=resamples),
        frames_median=median_time(
            kaplan_meier(*convergence_times(outcomes, "frames"), level=level)
        ),
        frames_mean=bootstrap(mean, [frames], rng, level=level, resamples=resamples),
        frames_total=int(outcomes.frames.sum()),
    )


def summarise_all(
    configurations: Sequence[Outcomes],
    rng: np.random.Generator,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
) -> list[Summary]:
    """One summary per configuration; a summary does not depend on the other configurations."""
    rngs = streams(rng, [f"{c.experiment}/{c.name}" for c in configurations])
    return [
        summarise(c, rngs[f"{c.experiment}/{c.name}"], level=level, resamples=resamples)
        for c in configurations
    ]
