"""Location and spread of the final score over trials."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from trl_explore.statistics.bootstrap import RESAMPLES, bootstrap
from trl_explore.statistics.estimates import LEVEL, Estimate

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass(frozen=True, eq=False)
class ScoreSummary:
    """Distribution of the final score of one configuration.

    Attributes:
        n: trials with a finite score.
        missing: trials without one (diverged before they had a score); not in the statistics.
        mean: mean with bootstrap interval.
        iqm: interquartile mean with bootstrap interval.
        sd: standard deviation (n - 1); NaN for one trial.
        levels: probabilities of the quantiles [k].
        quantiles: quantiles, linear interpolation [k].

    """

    n: int
    missing: int
    mean: Estimate
    iqm: Estimate
    sd: float
    levels: NDArray[np.float64]
    quantiles: NDArray[np.float64]


def interquartile_mean(scores: ArrayLike) -> Any:
    """Mean of the middle half: ⌊n/4⌋ values are cut from each end of the last axis.

    Args:
        scores: [..., n].

    Returns:
        [...], in units of score.

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
    """Mean, interquartile mean and quantiles of the final score, with bootstrap intervals.

    Args:
        scores: final score per trial [n]; NaN where a trial has none.
        rng: source of the resampling.
        level: confidence level.
        resamples: number of bootstrap resamples.

    Returns:
        The summary; all NaN where no trial has a score.

    >>> summarise_scores([1.0, 2.0, 3.0, 4.0], np.random.default_rng(0)).iqm.value
    2.5

    """
    values = np.asarray(scores, dtype=np.float64)
    finite = values[np.isfinite(values)]
    missing = len(values) - len(finite)
    levels = np.array(QUANTILES)
    if len(finite) == 0:
        nothing = Estimate(np.nan, np.nan, np.nan, level)
        return ScoreSummary(0, missing, nothing, nothing, np.nan, levels, np.full(5, np.nan))
    return ScoreSummary(
        n=len(finite),
        missing=missing,
        mean=bootstrap(_mean, [finite], rng, level=level, resamples=resamples),
        iqm=bootstrap(interquartile_mean, [finite], rng, level=level, resamples=resamples),
        sd=float(finite.std(ddof=1)) if len(finite) > 1 else np.nan,
        levels=levels,
        quantiles=np.quantile(finite, levels),
    )


def _mean(x: NDArray[np.float64]) -> Any:
    return x.mean(axis=-1)
