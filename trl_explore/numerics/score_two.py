"""The compiled sums of ``linear_softmax_score`` for two actions; see ``score_kernels``."""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from trl_explore.envs.kernels.kernel import kernel_function
from trl_explore.numerics import bell as bell_module
from trl_explore.numerics import borrow as borrow_module
from trl_explore.numerics import exponential as exponential_module
from trl_explore.numerics import returns, runs, vectors
from trl_explore.numerics.bell import ring
from trl_explore.numerics.borrow import borrow
from trl_explore.numerics.compiled import compiled
from trl_explore.numerics.exponential import exp32, log1p32
from trl_explore.numerics.returns import run_returns
from trl_explore.numerics.runs import end_of_run
from trl_explore.numerics.vectors import WIDTH, columns, dot

BLOCK = 256
"""How many frames of a trial are treated at a time, one operation after the other."""


@lru_cache(maxsize=32)
def score_two(  # noqa: C901 - small functions that close over the number of features
    n_features: int, single: bool
) -> Callable[..., bool]:
    """For two actions: d = logit of the other − logit of the chosen; log π = −log(1 + e^d).

    A block of frames at a time, one operation for all of them after the other, so that each is
    vector instructions. Blocks begin with the first frame of a trial, whatever stands before it.

    Returns:
        A kernel of (observation, action, advantage, reward, done, trial, weight, first, numbers,
        gamma, total, gradient, bell); the trials of weights and sums begin with ``first``. It
        takes the advantages, or, where there are rewards, forms them: the return less the second
        of the numbers.
    """
    take = columns(n_features)
    exponential, logarithm = (exp32, log1p32) if single else (np.exp, np.log1p)
    one = np.float32(1) if single else 1.0
    zero = one - one

    @kernel_function
    def read(observation, start, size, x):
        """The columns of a block's observations, with zeros up to a whole group."""
        whole = size // WIDTH
        take(observation, start, x, whole)
        for f in range(WIDTH * whole, WIDTH * ((size + WIDTH - 1) // WIDTH)):
            for k in range(n_features):
                x[k, f] = observation[start + f, k] if f < size else zero

    # Groups are whole, because what is left over of a loop is taken number by number.

    @kernel_function
    def logits(difference, x, d, groups):
        for f in range(WIDTH * groups):
            logit = difference[0] * x[0, f]
            for k in range(1, n_features):
                logit += difference[k] * x[k, f]
            d[f] = logit

    @kernel_function
    def log_probs(d, cost, share, groups):
        """Writes −log π(chosen), and multiplies the share with π(other)."""
        for place in range(0, WIDTH * groups, WIDTH):
            for j in range(WIDTH):
                f = place + j
                small = exponential(-abs(d[f]))  # never overflows
                cost[f] = logarithm(small) + (d[f] if d[f] > zero else zero)
                share[f] *= (small if d[f] < zero else one) / (one + small)

    modules = (bell_module, borrow_module, exponential_module, returns, runs, vectors)

    # One function, because the compiler must see that the arrays of a block do not overlap.
    @compiled(*modules, key=(n_features, single))
    def kernel(  # noqa: C901
        observation,
        action,
        advantage,
        reward,
        done,
        trial,
        weight,
        first,
        numbers,
        gamma,
        total,
        gradient,
        bell,
    ):
        ring(bell)
        dtype = weight.dtype
        own_x, own_rows = np.empty((n_features, BLOCK), dtype), np.zeros((4, BLOCK), dtype)
        own_difference, own_slope = np.empty(n_features, dtype), np.empty(n_features)
        x, rows = borrow(own_x), borrow(own_rows)
        difference, slope = borrow(own_difference), borrow(own_slope)
        d, cost, share, factor = rows[0], rows[1], rows[2], rows[3]
        observation, action, advantage = borrow(observation), borrow(action), borrow(advantage)
        own_returns = np.empty(0, dtype)
        scale, baseline = numbers[0], numbers[1]
        actions = np.int64(0)
        start, before = 0, np.int64(-1)
        while start < len(action):
            lane = trial[start] - first
            if not before < lane < len(weight):
                return False
            before, end = lane, end_of_run(trial, start)
            given, shift = advantage, 0
            if len(reward) > 0:
                if end - start > len(own_returns):
                    own_returns = np.empty(2 * (end - start), dtype)
                given, shift = borrow(own_returns), start
                run_returns(reward[start:end], done[start:end], given, gamma)
                for f in range(end - start):
                    given[f] -= baseline
            for k in range(n_features):
                difference[k] = weight[lane, 1, k] - weight[lane, 0, k]
                slope[k] = 0
            value = 0.0
            while start < end:
                size = min(BLOCK, end - start)
                groups = (size + WIDTH - 1) // WIDTH
                read(observation, start, size, x)
                logits(difference, x, d, groups)
                for f in range(size, WIDTH * groups):  # counts nothing
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
            total[lane] = value
            total[lane] *= scale
            for k in range(n_features):
                gradient[lane, 1, k] = slope[k]
                gradient[lane, 1, k] *= scale
                gradient[lane, 0, k] = -gradient[lane, 1, k]
        own_x[0, 0] = own_rows[0, 0] = own_difference[0] = own_slope[0] = 0  # alive to here
        own_returns[:1] = 0
        return 0 <= actions < 2

    return kernel
