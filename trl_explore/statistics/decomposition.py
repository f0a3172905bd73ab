"""The parts of a difference between two agents: acting, the bias of the gradient, and the data.

Two agents differ in how they act and in what their gradient assumes. With both factors crossed,
on the same trials, there are four cells; x is any quantity of a trial (iterations to learning, a
score):

                            gradient right      gradient as biased as the other's
    acts by the reference   reference           assumed
    acts by the other       corrected           plain

The difference plain − reference has two paths, and so two values of each part: the bias of the
gradient is assumed − reference on the data of the reference, and plain − corrected on those of the
other. What the bias does not explain is the effect of the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from trl_explore.statistics.estimates import LEVEL, Estimate, check_level


@dataclass(frozen=True, eq=False)
class Cells:
    """One quantity in the four cells, each [n], in the order of the same n trials.

    ``assumed`` or ``corrected`` may be None; the parts are then those of the other path.
    """

    reference: NDArray[np.float64]
    plain: NDArray[np.float64]
    assumed: NDArray[np.float64] | None = None
    corrected: NDArray[np.float64] | None = None

    @property
    def gap(self) -> NDArray[np.float64]:
        """The whole difference: plain − reference [n]."""
        return self.plain - self.reference

    def paths(self) -> list[NDArray[np.float64]]:
        """The bias along every path that was measured, each [n]."""
        found = []
        if self.assumed is not None:
            found.append(self.assumed - self.reference)
        if self.corrected is not None:
            found.append(self.plain - self.corrected)
        return found

    @property
    def bias(self) -> NDArray[np.float64]:
        """The mean of the paths [n], which is the Shapley value of the gradient.

        Raises:
            ValueError: neither cell was measured.

        Source: Shapley, A Value for n-Person Games (1953).
        """
        if not (paths := self.paths()):
            raise ValueError("the bias needs the assumed or the corrected cell")
        return np.mean(paths, axis=0)

    @property
    def data(self) -> NDArray[np.float64]:
        """What the bias does not explain: gap − bias [n]."""
        return self.gap - self.bias


def share_of(part: ArrayLike, whole: ArrayLike, *, level: float = LEVEL) -> Estimate:
    """mean(x) / mean(y) of pairs, with Fieller's interval.

    The interval is {ρ: |mean(x − ρ y)| ≤ t s(x − ρ y) / √n}, the shares that a paired t test does
    not reject. If the interval of mean(y) contains 0, the whole may be nothing, and every share of
    it is possible: value and bounds are NaN, "not estimable".

    Args:
        part: x [n].
        whole: y [n], of the same trials.
        level: confidence level.

    Raises:
        ValueError: no values, or unequal numbers of them.

    Source: Fieller, Some Problems in Interval Estimation, JRSS B 16 (1954).

    >>> share_of([1.0, 2.0, 3.0], [2.0, 4.0, 6.0])
    Estimate(value=nan, low=nan, high=nan, level=0.95)
    >>> found = share_of([8.0, 9.0, 10.0], [16.0, 18.0, 20.0])
    >>> found.value, round(found.low, 9), round(found.high, 9)
    (0.5, 0.5, 0.5)
    """
    check_level(level)
    x, y = np.asarray(part, dtype=np.float64), np.asarray(whole, dtype=np.float64)
    n = len(x)
    if n == 0 or len(y) != n:
        raise ValueError(f"{n} and {len(y)} values: a share needs pairs")
    unknown = Estimate(np.nan, np.nan, np.nan, level)
    if n < 2:
        return unknown
    covariance = np.cov(x, y) * _quantile(n, level) ** 2 / n
    a = y.mean() ** 2 - covariance[1, 1]
    if not a > 0:
        return unknown
    b = x.mean() * y.mean() - covariance[0, 1]
    c = x.mean() ** 2 - covariance[0, 0]
    half = np.sqrt(max(b * b - a * c, 0.0))
    return Estimate(float(x.mean() / y.mean()), float((b - half) / a), float((b + half) / a), level)


def curve_means(
    trial: NDArray[np.int64],
    iteration: NDArray[np.int64],
    value: NDArray[np.float64],
    end: int | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The mean height of each trial's curve: its area by the trapezoidal rule, over its length.

    Args:
        trial: trial of each point [n].
        iteration: its iteration [n], in any order; points of one iteration count with their mean.
        value: its height [n].
        end: a curve that ends earlier keeps its last value until here, and one that begins later
            has its first value before; None: every curve from its own first to its own last point.

    Returns:
        The trials [k], ascending, and the means [k].

    >>> mean = curve_means(np.zeros(2, int), np.array([0, 10]), np.array([0.0, 4.0]), 20)[1]
    >>> mean.tolist()
    [3.0]
    """
    order = np.lexsort((iteration, trial))
    trial, at, value = trial[order], iteration[order].astype(np.float64), value[order]
    fresh = np.flatnonzero(np.concatenate([[True], (np.diff(trial) != 0) | (np.diff(at) != 0)]))
    if len(fresh) < len(trial):
        counts = np.diff(np.append(fresh, len(trial)))
        value = np.add.reduceat(value, fresh) / counts
        trial, at = trial[fresh], at[fresh]
    names, first = np.unique(trial, return_index=True)
    last = np.append(first[1:], len(trial)) - 1
    inside = np.diff(trial) == 0
    areas = np.where(inside, np.diff(at) * (value[1:] + value[:-1]) / 2, 0.0)
    area = np.bincount(np.searchsorted(names, trial[:-1]), areas, len(names))
    length = at[last] - at[first]
    if end is not None:
        before, after = at[first], np.maximum(end - at[last], 0.0)
        area += before * value[first] + after * value[last]
        length += before + after
    return names, np.where(length > 0, area / np.where(length > 0, length, 1.0), value[first])


def same_weights(
    evaluated: tuple[NDArray[np.int64], NDArray[np.int64]],
    trained: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """The training score with the weights of each evaluation [n]; NaN if there is none.

    The evaluation after i iterations and the training episodes of iteration i + 1 use the same
    weights. Several episodes of one iteration count with their mean.

    Args:
        evaluated: trial and iteration of each evaluation [n].
        trained: trial, iteration (from 1) and score of each training episode [m].

    >>> one = np.zeros(1, int)
    >>> same_weights((one, one), (one, one + 1, np.array([7.0]))).tolist()
    [7.0]
    """
    trial, iteration, score = trained
    place, inverse = np.unique(_codes(trial, iteration - 1), return_inverse=True)
    mean = np.bincount(inverse, score) / np.maximum(np.bincount(inverse), 1)
    wanted = _codes(*evaluated)
    found = np.minimum(np.searchsorted(place, wanted), max(len(place) - 1, 0))
    if not len(place):
        return np.full(len(wanted), np.nan)
    return np.where(place[found] == wanted, mean[found], np.nan)


def aligned(
    keys: Sequence[Sequence[tuple[int, int]]], values: Sequence[NDArray[np.float64]]
) -> list[NDArray[np.float64]]:
    """The values [n] of the trials that all samples have in common, in one order.

    >>> [x.tolist() for x in aligned([[(0, 1), (0, 2)], [(0, 2)]], [np.arange(2.0), np.ones(1)])]
    [[1.0], [1.0]]
    """
    shared = set(keys[0]).intersection(*map(set, keys[1:]))
    order = [key for key in dict.fromkeys(keys[0]) if key in shared]
    found = []
    for own, sample in zip(keys, values, strict=True):
        where = {key: i for i, key in enumerate(own)}
        found.append(sample[np.array([where[key] for key in order], dtype=np.intp)])
    return found


def _codes(trial: NDArray[np.int64], iteration: NDArray[np.int64]) -> NDArray[np.int64]:
    return trial * 2**32 + iteration


def _quantile(n: int, level: float) -> float:
    return float(stats.t.isf((1.0 - level) / 2.0, n - 1))
