"""The compiled sums of ``linear_softmax_score``.

The kernels take trials in ascending order, so that each has its frames in one piece, and write S
and its gradient for those that have some. They return whether that is so, and whether all actions
and trials are in range. Sums are in double: hundreds of terms of one sign.
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.envs.kernels.kernel import kernel_function
from trl_explore.numerics import bell as bell_module
from trl_explore.numerics import borrow as borrow_module
from trl_explore.numerics.bell import ring
from trl_explore.numerics.borrow import borrow
from trl_explore.numerics.compiled import compiled

WIDE, SPARSE = 8, 2
"""From so many features on, of which no more than so many are not 0, zeros are passed over."""


def score_kernel(shape: tuple[int, ...], observation: NDArray[Any]) -> Callable[..., bool]:
    """The fastest for these observations.

    It takes (observation, action, advantage, trial, weight, first, numbers, total, gradient, bell);
    the trials of weights and sums begin with ``first``.

    Sums are multiplied with the first of the numbers, after they have been rounded. Which of the
    two kernels is chosen, by the data, changes no bit where the weights are finite; where they are
    not, 0 times infinity is passed over by one of them.

    Args:
        shape: that of the weights.
        observation: [frames, n_features].
    """
    one_hot = shape[2] >= WIDE and len(observation) and np.count_nonzero(observation[0]) <= SPARSE
    return score_sparse if one_hot else score


@compiled(borrow_module, bell_module)
def score_sparse(
    observation, action, advantage, trial, weight, first, numbers, total, gradient, bell
):
    """``score`` without the features that are 0: a one-hot state has one that is not."""
    ring(bell)
    trials, n_actions, n_features = weight.shape
    probs = np.empty(n_actions, dtype=weight.dtype)
    own_slope = np.zeros((n_actions, n_features))
    present = np.empty(n_features, dtype=np.int64)
    observation, weight, slope = borrow(observation), borrow(weight), borrow(own_slope)
    zero = np.zeros(1, dtype=weight.dtype)[0]
    i, before = 0, np.int64(-1)
    while i < len(action):
        lane = trial[i] - first
        if not before < lane < trials:
            return False
        before = lane
        slope[:] = 0
        value = 0.0
        while i < len(action) and trial[i] - first == lane:
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
        total[lane] *= numbers[0]
        gradient[lane] = slope
        gradient[lane] *= numbers[0]
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


@compiled(bell_module)
def score(observation, action, advantage, trial, weight, first, numbers, total, gradient, bell):
    """For any number of actions, frame by frame."""
    ring(bell)
    trials, n_actions, n_features = weight.shape
    probs = np.empty(n_actions, dtype=weight.dtype)
    slope = np.empty((n_actions, n_features))
    zero = np.zeros(1, dtype=weight.dtype)[0]
    i, before = 0, np.int64(-1)
    while i < len(action):
        lane = trial[i] - first
        if not before < lane < trials:
            return False
        before = lane
        slope[:] = 0
        value = 0.0
        while i < len(action) and trial[i] - first == lane:
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
        total[lane] *= numbers[0]
        gradient[lane] = slope
        gradient[lane] *= numbers[0]
    return True
