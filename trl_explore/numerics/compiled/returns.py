"""Discounted returns, compiled, and the ends of the frames of a trial and of an episode."""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import numpy as np

from trl_explore.numerics.compiled.cache import compiled, kernel_function

_1, _2, _3, _4, _5, _6, _7 = map(np.uint64, range(1, 8))


@kernel_function
def end_of_run(trial, start):
    """First index after ``start`` with another trial; twin: ``returns.plain_return_to_go``."""
    place = start + 1
    while place < len(trial) and trial[place] == trial[start]:
        place += 1
    return np.int64(place)


@kernel_function
def end_of_episode(done, start, stop):
    """Index after the next end, or ``stop``; twin: ``returns.plain_return_to_go``."""
    while start < stop and not done[start]:
        start += 1
    return min(start + 1, stop)


@compiled()
def returns(reward, done, out, trial, gamma):
    """The returns of every trial's frames; twin: ``returns.plain_return_to_go``."""
    start = 0
    while start < len(reward):
        end = end_of_run(trial, start)
        run_returns(reward[start:end], done[start:end], out[start:end], gamma)
        start = end


@kernel_function
def run_returns(reward, done, out, gamma):
    """The returns of one trial's frames, in double; twin: ``returns.plain_return_to_go``.

    float32 rewards are processed in blocks of eight frames, from the last to the first. Let l_t be
    the discounted sum from t to the end of its block, and G the return after the block, which
    begins j frames after t: then G_t = l_t + γ^j G. Only this step depends on the following block.
    The blocks of an episode begin with its first frame.
    """
    g1, g2, g4 = gamma, gamma * gamma, gamma * gamma * gamma * gamma
    g3, g5, g6, g7, g8 = g2 * g1, g4 * g1, g4 * g2, g4 * g2 * g1, g4 * g4
    start = 0
    while start < len(reward):
        end = end_of_episode(done, start, len(reward))
        whole = (end - start) // 8 if reward.itemsize == 4 else 0
        after = 0.0
        for t in range(end - 1, start + 8 * whole - 1, -1):
            after = reward[t] + gamma * after
            out[t] = after
        for place in range(start + 8 * (whole - 1), start - 1, -8):
            t = np.uint64(place)  # a signed index could be negative, which keeps LLVM from vectors
            l7 = np.float64(reward[t + _7])
            l6 = reward[t + _6] + gamma * l7
            l5 = reward[t + _5] + gamma * l6
            l4 = reward[t + _4] + gamma * l5
            l3 = reward[t + _3] + gamma * l4
            l2 = reward[t + _2] + gamma * l3
            l1 = reward[t + _1] + gamma * l2
            l0 = reward[t] + gamma * l1
            out[t + _7], out[t + _6] = l7 + g1 * after, l6 + g2 * after
            out[t + _5], out[t + _4] = l5 + g3 * after, l4 + g4 * after
            out[t + _3], out[t + _2] = l3 + g5 * after, l2 + g6 * after
            out[t + _1] = l1 + g7 * after
            after = l0 + g8 * after
            out[t] = after
        start = end
