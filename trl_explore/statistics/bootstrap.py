"""Percentile bootstrap over trials, and independent random streams by label."""

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
# Numbers drawn at once: bounds the memory at 10,000 trials without a Python loop per resample.
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
    """Percentile bootstrap interval of a statistic of one or several samples of trials.

    θ*_b = θ(x drawn with replacement), b = 1..B;  interval = the (1 ± level)/2 quantiles of θ*

    The quantiles are rounded outwards to order statistics, so that infinite resamples (no
    trial converged) stay infinite instead of becoming NaN.

    Bounds are NaN where a sample has fewer than two trials or a resample has no defined statistic.
    A sample without variance gives an interval without width.

    Args:
        statistic: takes the samples with trials in the last axis, reduces that axis.
        samples: arrays [n_i].
        rng: source of the resampling.
        paired: draw the same trials from every sample (all n_i equal).
        level: confidence level.
        resamples: B.

    Raises:
        ValueError: no sample, an empty one, unequal lengths with ``paired``, B < 1.

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
        # SciPy's own interval interpolates, so that inf becomes NaN. Only its draws are used.
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
    """x̄ over the last axis, for :func:`bootstrap`."""
    return x.mean(axis=-1)


def streams(rng: np.random.Generator, labels: Iterable[str]) -> dict[str, np.random.Generator]:
    """Independent generators, one per label, each a function of (state of ``rng``, label).

    What is drawn for one label does not depend on which other labels there are, so that one
    configuration more in a report leaves the intervals of the others as they were.

    >>> a = streams(np.random.default_rng(0), ["x"])["x"].random()
    >>> a == streams(np.random.default_rng(0), ["w", "x"])["x"].random()
    True
    """
    root = int(rng.integers(2**63))
    return {
        label: np.random.default_rng(np.random.SeedSequence([root, zlib.crc32(label.encode())]))
        for label in labels
    }
