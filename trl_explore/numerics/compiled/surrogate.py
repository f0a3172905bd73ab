"""The surrogate of a linear softmax policy and its gradient, compiled: ``numerics.surrogate``.

The kernels expect trials in ascending order, so that the frames of each are contiguous, and write S
and its gradient for the trials that have frames. They return False if the trials are not in
ascending order, or an action or trial is out of range. Sums are in double, because hundreds of
terms may have the same sign; they are rounded and then multiplied by ``scale`` [1].
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.numerics.compiled import arrays, elementary, returns
from trl_explore.numerics.compiled.arrays import WIDTH, borrow, columns, dot
from trl_explore.numerics.compiled.cache import compiled, kernel_function
from trl_explore.numerics.compiled.elementary import exp32, log1p32
from trl_explore.numerics.compiled.returns import end_of_run, run_returns

WIDE, SPARSE = 8, 2
"""Zeros are skipped if there are at least WIDE features, of which at most SPARSE are not 0."""
BLOCK = 256
"""The number of frames of a trial that an operation processes before the next operation."""


def surrogate_kernel(shape: tuple[int, ...], observation: NDArray[Any]) -> Callable[..., bool]:
    """``surrogate_many`` for weights of a shape, chosen by the first observation [n_features].

    If the weights are finite, the choice changes no bit; if they are not, skipping zeros leaves out
    0 times infinity.
    """
    present = np.count_nonzero(observation[0]) if len(observation) else shape[2]
    return surrogate_many(shape[2] >= WIDE and present <= SPARSE)


@kernel_function
def _find(x, present):
    """Write the indices of the nonzero entries and return their number; fast if there is one."""
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
    """Replace logits by e^(logit − largest logit); returns log π(chosen) and their sum."""
    largest = probs.max()
    log_prob = probs[chosen] - largest
    normaliser = zero
    for a in range(len(probs)):
        probs[a] = np.exp(probs[a] - largest)
        normaliser += probs[a]
    return log_prob - np.log(normaliser), normaliser


@lru_cache(maxsize=2)
def surrogate_many(  # noqa: C901 - the loops of one compiled function
    sparse: bool,
) -> Callable[..., bool]:
    """Any number of actions, frame by frame; twin: ``surrogate.plain_linear_softmax_surrogate``.

    Args:
        sparse: whether to skip the zeros of the observations.

    Returns:
        A kernel of (observation, action, advantage, trial, weight, scale, total, gradient).
    """

    @compiled(arrays, key=sparse)
    def kernel(observation, action, advantage, trial, weight, scale, total, gradient):
        trials, n_actions, n_features = weight.shape
        probs = np.empty(n_actions, dtype=weight.dtype)
        own_slope = np.zeros((n_actions, n_features))
        present, count = np.arange(n_features), n_features
        observation, weight, slope = borrow(observation), borrow(weight), borrow(own_slope)
        zero = np.zeros(1, dtype=weight.dtype)[0]
        i, before = 0, np.int64(-1)
        while i < len(action):
            row = trial[i]
            if not before < row < trials:
                return False
            before = row
            slope[:] = 0
            value = 0.0
            while i < len(action) and trial[i] == row:
                chosen, factor = action[i], np.float64(advantage[i])
                if not 0 <= chosen < n_actions:
                    return False
                if sparse:
                    count = _find(observation[i], present)
                for a in range(n_actions):
                    logit = zero
                    for j in range(count):
                        k = present[j] if sparse else j
                        logit += weight[row, a, k] * observation[i, k]
                    probs[a] = logit
                log_prob, normaliser = _exponentials(probs, chosen, zero)
                value += factor * log_prob
                for a in range(n_actions):
                    share = factor * (np.float64(a == chosen) - np.float64(probs[a] / normaliser))
                    for j in range(count):
                        k = present[j] if sparse else j
                        slope[a, k] += share * observation[i, k]
                i += 1
            total[row] = value
            total[row] *= scale[0]
            gradient[row] = slope
            gradient[row] *= scale[0]
        own_slope[0, 0] = 0  # keeps the array alive until here
        return True

    return kernel


@lru_cache(maxsize=32)
def surrogate_two(  # noqa: C901 - small functions that close over the number of features
    n_features: int, single: bool
) -> Callable[..., bool]:
    """S for two actions, in blocks of frames; twin: ``surrogate.plain_linear_softmax_surrogate``.

    With d = logit of the other action − logit of the chosen one, log π = −log(1 + e^d).

    Each operation runs over a whole block of frames before the next operation, so that it becomes
    vector instructions. Blocks begin with the first frame of a trial, so that a trial's sums do not
    depend on the frames before it.

    Returns:
        A kernel of (observation, action, advantage, reward, done, trial, weight, scale, baseline,
        gamma, total, gradient). If there are rewards, it computes the advantages from them: the
        return minus the baseline [1].
    """
    take = columns(n_features)
    exponential, logarithm = (exp32, log1p32) if single else (np.exp, np.log1p)
    one = np.float32(1) if single else 1.0
    zero = one - one

    @kernel_function
    def read(observation, start, size, x):
        """Transpose a block of observations to ``x``, padded with zeros to whole groups."""
        whole = size // WIDTH
        take(observation, start, x, whole)
        for f in range(WIDTH * whole, WIDTH * ((size + WIDTH - 1) // WIDTH)):
            for k in range(n_features):
                x[k, f] = observation[start + f, k] if f < size else zero

    # Groups are whole, because the remainder of a vectorised loop runs one number at a time.

    @kernel_function
    def logits(difference, x, d, groups):
        for f in range(WIDTH * groups):
            logit = difference[0] * x[0, f]
            for k in range(1, n_features):
                logit += difference[k] * x[k, f]
            d[f] = logit

    @kernel_function
    def log_probs(d, cost, share, groups):
        """Write −log π(chosen) to ``cost``, and multiply ``share`` by π(other)."""
        for place in range(0, WIDTH * groups, WIDTH):
            for j in range(WIDTH):
                f = place + j
                small = exponential(-abs(d[f]))  # never overflows
                cost[f] = logarithm(small) + (d[f] if d[f] > zero else zero)
                share[f] *= (small if d[f] < zero else one) / (one + small)

    modules = (arrays, elementary, returns)

    # One function, so that the compiler sees that the arrays of a block do not overlap.
    @compiled(*modules, key=(n_features, single))
    def kernel(  # noqa: C901
        observation,
        action,
        advantage,
        reward,
        done,
        trial,
        weight,
        scale,
        baseline,
        gamma,
        total,
        gradient,
    ):
        dtype = weight.dtype
        own_x, own_rows = np.empty((n_features, BLOCK), dtype), np.zeros((4, BLOCK), dtype)
        own_difference, own_slope = np.empty(n_features, dtype), np.empty(n_features)
        x, rows = borrow(own_x), borrow(own_rows)
        difference, slope = borrow(own_difference), borrow(own_slope)
        d, cost, share, factor = rows[0], rows[1], rows[2], rows[3]
        observation, action, advantage = borrow(observation), borrow(action), borrow(advantage)
        own_returns = np.empty(0, dtype)
        factor_of_sums, shift_of_returns = scale[0], baseline[0]  # scalars: an array might overlap
        actions = np.int64(0)
        start, before = 0, np.int64(-1)
        while start < len(action):
            row = trial[start]
            if not before < row < len(weight):
                return False
            before, end = row, end_of_run(trial, start)
            given, shift = advantage, 0
            if len(reward) > 0:
                if end - start > len(own_returns):
                    own_returns = np.empty(2 * (end - start), dtype)
                given, shift = borrow(own_returns), start
                run_returns(reward[start:end], done[start:end], given, gamma)
                for f in range(end - start):
                    given[f] -= shift_of_returns
            for k in range(n_features):
                difference[k] = weight[row, 1, k] - weight[row, 0, k]
                slope[k] = 0
            value = 0.0
            while start < end:
                size = min(BLOCK, end - start)
                groups = (size + WIDTH - 1) // WIDTH
                read(observation, start, size, x)
                logits(difference, x, d, groups)
                for f in range(size, WIDTH * groups):  # padding: adds nothing
                    d[f] = share[f] = factor[f] = zero
                chosen_of = action[start : start + size]
                factor_of = given[start - shift : start - shift + size]
                for f in range(size):
                    chosen = chosen_of[f]
                    actions |= chosen
                    factor[f] = factor_of[f]
                    share[f] = factor[f] if chosen != 0 else -factor[f]
                    d[f] = -d[f] if chosen != 0 else d[f]
                log_probs(d, cost, share, groups)
                value -= dot(factor, cost, groups)
                for k in range(n_features):
                    slope[k] += dot(share, x[k], groups)
                start += size
            total[row] = value
            total[row] *= factor_of_sums
            for k in range(n_features):
                gradient[row, 1, k] = slope[k]
                gradient[row, 1, k] *= factor_of_sums
                gradient[row, 0, k] = -gradient[row, 1, k]
        own_x[0, 0] = own_rows[0, 0] = own_difference[0] = own_slope[0] = 0  # alive until here
        own_returns[:1] = 0
        return 0 <= actions < 2

    return kernel
