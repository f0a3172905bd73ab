"""The compiled sums of ``linear_softmax_score``.

The kernels take trials in ascending order, so that each has its frames in one piece, and write S
and its gradient for those that have some. They return whether that is so, and whether all actions
and trials are in range. Sums are in double: hundreds of terms of one sign.
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.compiled import compiled
from trl_explore.kernels import borrow as borrow_module
from trl_explore.kernels.base import kernel_function
from trl_explore.kernels.borrow import borrow
from trl_explore.ops import exponential as exponential_module
from trl_explore.ops import runs, vectors
from trl_explore.ops.exponential import exp32, log1p32
from trl_explore.ops.runs import end_of_run
from trl_explore.ops.vectors import WIDTH, columns, dot

WIDE, SPARSE = 8, 2
"""From so many features on, of which no more than so many are not 0, zeros are passed over."""
BLOCK = 256
"""How many frames of a trial are treated at a time, one operation after the other."""


def score_kernel(shape: tuple[int, ...], observation: NDArray[Any]) -> Callable[..., bool]:
    """The fastest ``score(observation, action, advantage, trial, weight, total, gradient)``.

    Which of the last two is chosen, by the data, changes no bit.

    Args:
        shape: that of the weights.
        observation: [frames, n_features].
    """
    if shape[1] == 2:
        return score_two(shape[2], observation.dtype == np.float32)
    one_hot = shape[2] >= WIDE and len(observation) and np.count_nonzero(observation[0]) <= SPARSE
    return score_sparse if one_hot else score


@compiled(borrow_module)
def score_sparse(observation, action, advantage, trial, weight, total, gradient):
    """``score`` without the features that are 0: a one-hot state has one that is not."""
    trials, n_actions, n_features = weight.shape
    probs = np.empty(n_actions, dtype=weight.dtype)
    own_slope = np.zeros((n_actions, n_features))
    present = np.empty(n_features, dtype=np.int64)
    observation, weight, slope = borrow(observation), borrow(weight), borrow(own_slope)
    zero = np.zeros(1, dtype=weight.dtype)[0]
    i, before = 0, np.int64(-1)
    while i < len(action):
        lane = trial[i]
        if not before < lane < trials:
            return False
        before = lane
        slope[:] = 0
        value = 0.0
        while i < len(action) and trial[i] == lane:
            chosen, factor = action[i], np.float64(advantage[i])
            if not 0 <= chosen < n_actions:
                return False
            count = _find(observation[i], present)
            for a in range(n_actions):
                logit = zero
                for k in present[:count]:
                    logit += weight[lane, a, k] * observation[i, k]
                probs[a] = logit
            log_prob, normaliser = _exponentials(probs, chosen, zero)
            value += factor * log_prob
            for a in range(n_actions):
                share = factor * (np.float64(a == chosen) - np.float64(probs[a] / normaliser))
                for k in present[:count]:
                    slope[a, k] += share * observation[i, k]
            i += 1
        total[lane] = value
        gradient[lane] = slope
    own_slope[0, 0] = 0  # keeps it alive to here
    return True


@kernel_function
def _find(x, present):
    """Write the places of what is not 0, and count them; fast where there is one."""
    count = place = np.int32(0)
    for k in range(len(x)):
        hit = np.int32(x[k] != 0)
        count += hit
        place += hit * np.int32(k)
    present[0] = place
    if count > 1:
        count = np.int32(0)
        for k in range(len(x)):
            if x[k] != 0:
                present[count] = k
                count += np.int32(1)
    return count


@kernel_function
def _exponentials(probs, chosen, zero):
    """Logits become e^(logit − the largest), in place; returns log π(chosen) and their sum."""
    largest = probs.max()
    log_prob = probs[chosen] - largest
    normaliser = zero
    for a in range(len(probs)):
        probs[a] = np.exp(probs[a] - largest)
        normaliser += probs[a]
    return log_prob - np.log(normaliser), normaliser


@compiled()
def score(observation, action, advantage, trial, weight, total, gradient):
    """For any number of actions, frame by frame."""
    trials, n_actions, n_features = weight.shape
    probs = np.empty(n_actions, dtype=weight.dtype)
    slope = np.empty((n_actions, n_features))
    zero = np.zeros(1, dtype=weight.dtype)[0]
    i, before = 0, np.int64(-1)
    while i < len(action):
        lane = trial[i]
        if not before < lane < trials:
            return False
        before = lane
        slope[:] = 0
        value = 0.0
        while i < len(action) and trial[i] == lane:
            chosen, factor = action[i], np.float64(advantage[i])
            if not 0 <= chosen < n_actions:
                return False
            for a in range(n_actions):
                logit = weight[lane, a, 0] * observation[i, 0]
                for k in range(1, n_features):
                    logit += weight[lane, a, k] * observation[i, k]
                probs[a] = logit
            log_prob, normaliser = _exponentials(probs, chosen, zero)
            value += factor * log_prob
            for a in range(n_actions):
                share = factor * (np.float64(a == chosen) - np.float64(probs[a] / normaliser))
                for k in range(n_features):
                    slope[a, k] += share * observation[i, k]
            i += 1
        total[lane] = value
        gradient[lane] = slope
    return True


@lru_cache(maxsize=32)
def score_two(  # noqa: C901 - small functions that close over the number of features
    n_features: int, single: bool
) -> Callable[..., bool]:
    """For two actions: d = logit of the other − logit of the chosen; log π = −log(1 + e^d).

    A block of frames at a time, one operation for all of them after the other, so that each is
    vector instructions. Blocks begin with the first frame of a trial, whatever stands before it.
    """
    take = columns(n_features)
    exponential, logarithm = (exp32, log1p32) if single else (np.exp, np.log1p)

    @kernel_function
    def read(observation, start, size, x, zero):
        """The columns of a block's observations, with zeros up to a whole group."""
        whole = size // WIDTH
        take(observation, start, x, whole)
        for f in range(WIDTH * whole, WIDTH * ((size + WIDTH - 1) // WIDTH)):
            for k in range(n_features):
                x[k, f] = observation[start + f, k] if f < size else zero

    @kernel_function
    def logits(difference, x, d, size):
        for f in range(size):
            logit = difference[0] * x[0, f]
            for k in range(1, n_features):
                logit += difference[k] * x[k, f]
            d[f] = logit

    @kernel_function
    def log_probs(d, cost, share, size, one):
        """Writes −log π(chosen), and multiplies the share with π(other)."""
        zero = one - one
        for f in range(size):
            small = exponential(-abs(d[f]))  # never overflows
            cost[f] = logarithm(small) + (d[f] if d[f] > zero else zero)
            share[f] *= (small if d[f] < zero else one) / (one + small)

    @compiled(borrow_module, exponential_module, runs, vectors, key=(n_features, single))
    def kernel(observation, action, advantage, trial, weight, total, gradient):
        dtype = weight.dtype
        one = np.ones(1, dtype)[0]
        own_x, own_rows = np.empty((n_features, BLOCK), dtype), np.zeros((4, BLOCK), dtype)
        own_difference, own_slope = np.empty(n_features, dtype), np.empty(n_features)
        x, rows = borrow(own_x), borrow(own_rows)
        difference, slope = borrow(own_difference), borrow(own_slope)
        d, cost, share, factor = rows[0], rows[1], rows[2], rows[3]
        action, advantage = borrow(action), borrow(advantage)
        actions = np.int64(0)
        start, before = 0, np.int64(-1)
        while start < len(action):
            lane = trial[start]
            if not before < lane < len(weight):
                return False
            before, end = lane, end_of_run(trial, start)
            for k in range(n_features):
                difference[k] = weight[lane, 1, k] - weight[lane, 0, k]
                slope[k] = 0
            value = 0.0
            while start < end:
                size = min(BLOCK, end - start)
                groups = (size + WIDTH - 1) // WIDTH
                read(observation, start, size, x, one - one)
                logits(difference, x, d, size)
                rows[1:, size : WIDTH * groups] = 0
                chosen_of, factor_of = action[start : start + size], advantage[start : start + size]
                for f in range(size):
                    chosen = chosen_of[f]
                    actions |= chosen
                    factor[f] = factor_of[f]
                    share[f] = factor[f] if chosen != 0 else -factor[f]
                    d[f] = -d[f] if chosen != 0 else d[f]
                log_probs(d, cost, share, size, one)
                value -= dot(factor, cost, groups)
                for k in range(n_features):
                    slope[k] += dot(share, x[k], groups)
                start += size
            total[lane] = value
            for k in range(n_features):
                gradient[lane, 1, k] = slope[k]
                gradient[lane, 0, k] = -slope[k]
        own_x[0, 0] = own_rows[0, 0] = own_difference[0] = own_slope[0] = 0  # alive to here
        return 0 <= actions < 2

    return kernel
