"""All estimates for one configuration; the distribution of its final scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from trl_explore.statistics import samples
from trl_explore.statistics.estimates import LEVEL, Estimate, check_level, flat, pass_rate
from trl_explore.statistics.means import mean_interval
from trl_explore.statistics.outcomes import Outcomes, convergence_times
from trl_explore.statistics.samples import Sample
from trl_explore.statistics.survival import kaplan_meier, median_time, time_per_success

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass(frozen=True, eq=False)
class ScoreSummary:
    """Distribution of the final scores of one configuration.

    Attributes:
        n: trials with a finite score; ``missing`` others diverged before they had one.
        mean, iqm: mean and interquartile mean.
        sd: standard deviation (n - 1); NaN for one trial.
        quantiles: quantiles [5] at the probabilities ``QUANTILES``, by linear interpolation.
    """

    n: int
    missing: int
    mean: Estimate
    iqm: Estimate
    sd: float
    quantiles: NDArray[np.float64]


def interquartile_mean(values: ArrayLike, *, level: float = LEVEL) -> Estimate:
    """Mean of the middle half of values [n], with the interval of Tukey and McLaughlin.

    ⌊n/4⌋ values are removed at each end; x̄ ± t s_w / (½ √n) with the winsorised standard
    deviation s_w. A few trials cannot move it. NaN bounds with fewer than three values left.

    Source: Agarwal et al., Deep RL at the Edge of the Statistical Precipice (2021), §4.3; Tukey &
    McLaughlin, Sankhyā A 25 (1963); ``scipy.stats.mstats.trimmed_mean_ci``.

    >>> interquartile_mean([0.0, 2.0, 4.0, 1000.0]).value
    3.0
    """
    check_level(level)
    x = np.asarray(values, dtype=np.float64)
    value = float(stats.trim_mean(x, 0.25))
    if len(x) - 2 * (len(x) // 4) < 3:
        return Estimate(value, np.nan, np.nan, level)
    low, high = stats.mstats.trimmed_mean_ci(x, (0.25, 0.25), alpha=1.0 - level)
    return Estimate(value, float(low), float(high), level)


def summarise_scores(
    scores: Sample, *, trials: int | None = None, level: float = LEVEL
) -> ScoreSummary:
    """Mean, interquartile mean and quantiles of final scores.

    Args:
        scores: the scores of the trials that have one.
        trials: number of all trials; by default, all have a score.
        level: confidence level.

    >>> summarise_scores(Sample.of([1.0, 2.0, 3.0, 4.0])).iqm.value
    2.5
    """
    values = scores.values
    missing = 0 if trials is None else trials - len(values)
    if len(values) == 0:
        nothing = Estimate(np.nan, np.nan, np.nan, level)
        return ScoreSummary(0, missing, nothing, nothing, np.nan, np.full(5, np.nan))
    return ScoreSummary(
        n=len(values),
        missing=missing,
        mean=mean_interval(scores, level=level),
        iqm=interquartile_mean(values, level=level).within(*scores.bounds),
        sd=float(values.std(ddof=1)) if len(values) > 1 else np.nan,
        quantiles=np.quantile(values, QUANTILES),
    )


@dataclass(frozen=True, eq=False)
class Summary:
    """The statistics of one configuration; diverged trials count as never converging.

    Attributes:
        n, converged, diverged: numbers of trials.
        pass_rate: share of trials that converged, with Wilson's interval.
        median: Kaplan-Meier median of iterations; ``inf``: not reached.
        restricted_mean: E[min(T, cap)], iterations.
        expected_running_time: iterations per success with restarts; ``inf``: none converged.
        score: distribution of the final scores.
        frames_median: median frames to convergence; ``inf``: not reached.
        frames_mean: mean frames until a trial stopped, converged or not.
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
    restricted_mean: Estimate
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
                "median", "restricted_mean", "expected_running_time",
            )
        }  # fmt: skip
        row |= {"score_mean": self.score.mean, "score_iqm": self.score.iqm}
        row |= {"frames_median": self.frames_median, "frames_mean": self.frames_mean}
        for p, q in zip(QUANTILES, self.score.quantiles, strict=True):
            row[f"score_q{round(100 * p):02d}"] = float(q)
        return flat(row) | {"frames_total": self.frames_total}


def summarise(outcomes: Outcomes, *, level: float = LEVEL) -> Summary:
    """All statistics of one configuration; see the functions that compute them.

    Raises:
        ValueError: no trials, or an unfinished job (see ``convergence_times``).
    """
    durations, converged = convergence_times(outcomes)
    times = samples.iterations(outcomes)
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
        restricted_mean=mean_interval(times, level=level),
        expected_running_time=time_per_success(times, level=level),
        score=summarise_scores(samples.scores(outcomes), trials=len(outcomes), level=level),
        frames_median=median_time(
            kaplan_meier(*convergence_times(outcomes, "frames"), level=level)
        ),
        frames_mean=mean_interval(samples.frames(outcomes), level=level),
        frames_total=int(outcomes.frames.sum()),
    )
