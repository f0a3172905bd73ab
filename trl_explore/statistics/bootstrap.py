"""Percentile bootstrap over trials; independent random streams by label."""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from trl_explore.statistics.estimates import LEVEL, Estimate, check_level

RESAMPLES = 9999
# Numbers drawn at once: limits memory with many trials.
BATCH = 2_000_000


def bootstrap(
    statistic: Callable[..., Any],
    samples: Sequence[ArrayLike],
    rng: np.random.Generator,
    *,
    paired: bool = False,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
) -> Estimate:
    """Percentile bootstrap interval of a statistic of one or more samples of trials.

    θ*_b = θ(x drawn with replacement), b = 1..B;  interval = the (1 ± level)/2 quantiles of θ*

    The quantiles are rounded outwards to order statistics, so that infinite values (resamples in
    which no trial converged) stay infinite instead of becoming NaN.

    Bounds are NaN if a sample has fewer than two trials or the statistic of a resample is NaN. A
    sample without variance gives an interval of zero width.

    Args:
        statistic: function of the samples that reduces their last axis, the trials.
        samples: arrays [n_i].
        rng: source of the resampling.
        paired: draw the same trials from every sample; all n_i must be equal.
        level: confidence level.
        resamples: B.

    Raises:
        ValueError: no sample, an empty sample, unequal lengths with ``paired``, or B < 1.

    Source: Efron & Tibshirani, An Introduction to the Bootstrap (1993), ch. 13.

    >>> bootstrap(lambda x: x.mean(-1), [[3.0, 3.0, 3.0]], np.random.default_rng(0))
    Estimate(value=3.0, low=3.0, high=3.0, level=0.95)

    """
    check_level(level)
    arrays = [np.asarray(sample) for sample in samples]
    sizes = [len(array) for array in arrays]
    if not arrays or min(sizes) == 0:
        raise ValueError(f"samples of {sizes} trials: each needs at least one")
    if paired and len(set(sizes)) > 1:
        raise ValueError(f"paired samples of {sizes} trials: all need the same number")
    if resamples < 1:
        raise ValueError(f"resamples={resamples}: at least 1 is needed")
    value = float(statistic(*arrays))
    if min(sizes) < 2:
        return Estimate(value, np.nan, np.nan, level)
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):
        # Only SciPy's draws are used: its interval interpolates, which turns inf into NaN.
        warnings.simplefilter("ignore")
        result = stats.bootstrap(
            arrays,
            lambda *drawn, axis: statistic(*drawn),
            paired=paired,
            n_resamples=resamples,
            batch=max(1, BATCH // max(sizes)),
            method="percentile",
            rng=rng,
        )
    drawn = np.sort(result.bootstrap_distribution)
    if np.isnan(drawn).any():
        return Estimate(value, np.nan, np.nan, level)
    tail = (1.0 - level) / 2.0 * (resamples - 1)
    low, high = drawn[int(np.floor(tail))], drawn[resamples - 1 - int(np.floor(tail))]
    return Estimate(value, float(low), float(high), level)


def mean(x: NDArray[np.float64]) -> Any:
    """Mean x̄ over the last axis, for :func:`bootstrap`."""
    return x.mean(axis=-1)


def streams(rng: np.random.Generator, labels: Iterable[str]) -> dict[str, np.random.Generator]:
    """Independent generators, one per label, each a function of (state of ``rng``, label).

    The draws for one label do not depend on the other labels, so adding a configuration to a
    report does not change the intervals of the others.

    >>> a = streams(np.random.default_rng(0), ["x"])["x"].random()
    >>> a == streams(np.random.default_rng(0), ["w", "x"])["x"].random()
    True
    """
    root = int(rng.integers(2**63))
    return {
        label: np.random.default_rng(np.random.SeedSequence([root, zlib.crc32(label.encode())]))
        for label in labels
    }
