"""The sum that every policy gradient is made of, for a linear-softmax policy, in one pass."""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numba as nb
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from trl_explore.kernels.base import kernel_function
from trl_explore.kernels.borrow import borrow
from trl_explore.ops.linear import lane_linear
from trl_explore.ops.log_prob import categorical_log_prob
from trl_explore.threads import by_trial, check_frames, fits

WIDE, SPARSE = 8, 2
"""From so many features on, of which no more than so many are not 0, zeros are passed over."""


def lane_sum(values: Tensor, trial: Tensor, trials: int) -> Tensor:
    """S_k = Σ_{i: trial_i = k} values_i, summed in the order of the frames.

    Args:
        values: [frames].
        trial: [frames] int64 in [0, trials).
        trials: the number of sums.

    Returns:
        [trials].

    Example:
        >>> lane_sum(torch.tensor([1.0, 2.0, 3.0]), torch.tensor([0, 0, 2]), 3).tolist()
        [3.0, 0.0, 3.0]
    """
    return values.new_zeros(trials).index_add(0, trial, values)


def linear_softmax_score(
    observation: Tensor, weight: Tensor, action: Tensor, advantage: Tensor, trial: Tensor
) -> Tensor:
    """S_k = Σ_{i: trial_i = k} A_i log softmax(W_k x_i)_{a_i}.

    Its gradient, ∂S_k/∂W_k = Σ_i A_i (e_{a_i} − softmax(W_k x_i)) x_iᵀ, is summed in the same pass
    over the frames, so that nothing is stored for the way back.

    Args:
        observation: x [frames, n_features].
        weight: W [trials, n_actions, n_features].
        action: a [frames] int64.
        advantage: A [frames], a constant factor of each frame.
        trial: [frames] int64.

    Returns:
        S [trials].

    Raises:
        ValueError: if the shapes do not fit each other.
        IndexError: if an action or trial is out of range.

    Example:
        >>> x, w = torch.ones(3, 1), torch.zeros(2, 2, 1)
        >>> action, trial = torch.tensor([0, 1, 1]), torch.tensor([0, 0, 1])
        >>> score = linear_softmax_score(x, w, action, torch.ones(3), trial)
        >>> (score / torch.tensor(0.5).log()).tolist()
        [2.0, 1.0]
    """
    check_frames(observation.shape[:1], action=action, advantage=advantage, trial=trial)
    if observation.shape[1] != weight.shape[2]:
        raise ValueError(
            f"observation has {observation.shape[1]} features, the weights {weight.shape[2]}"
        )
    if not fits(observation, weight, advantage) or observation.requires_grad:
        logits = lane_linear(observation, weight, trial)
        return lane_sum(categorical_log_prob(logits, action) * advantage, trial, len(weight))
    return _LinearSoftmaxScore.apply(observation, weight, action, advantage, trial)  # type: ignore[return-value]


class _LinearSoftmaxScore(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        observation: Tensor,
        weight: Tensor,
        action: Tensor,
        advantage: Tensor,
        trial: Tensor,
    ) -> Tensor:
        w = weight.detach().contiguous().numpy()
        gradient, total = np.zeros(w.shape), np.zeros(len(w))  # in double, whatever the weights
        frames = (
            observation.contiguous().numpy(),
            action.contiguous().numpy(),
            advantage.contiguous().numpy(),
            trial.contiguous().numpy(),
        )
        valid = by_trial(_kernel(w.shape, frames[0]), frames, (w, total, gradient))
        if not valid:
            raise IndexError(
                f"an action is not in [0, {w.shape[1]}) or a trial not in [0, {len(w)})"
            )
        ctx.gradient = torch.from_numpy(gradient).to(weight.dtype)
        return torch.from_numpy(total).to(weight.dtype)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[None, Tensor, None, None, None]:
        return None, grad.reshape(-1, 1, 1) * ctx.gradient, None, None, None


def _kernel(shape: tuple[int, ...], observation: NDArray[Any]) -> Callable[..., bool]:
    """The fastest kernel; which of the last two, chosen by the data, changes no bit."""
    if shape[1] == 2:
        return _score_two(shape[2])
    one_hot = shape[2] >= WIDE and len(observation) and np.count_nonzero(observation[0]) <= SPARSE
    return _score_sparse if one_hot else _score


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _score_sparse(observation, action, advantage, trial, weight, total, gradient):
    """``_score`` without the features that are 0: a one-hot state has one that is not."""
    trials, n_actions, n_features = weight.shape
    probs = np.empty(n_actions, dtype=weight.dtype)
    present = np.empty(n_features, dtype=np.int64)
    observation, weight, gradient = borrow(observation), borrow(weight), borrow(gradient)
    zero = np.zeros(1, dtype=weight.dtype)[0]
    for i in range(len(action)):
        lane, chosen, factor = trial[i], action[i], np.float64(advantage[i])
        if not (0 <= lane < trials and 0 <= chosen < n_actions):
            return False
        count = _find(observation[i], present)
        for a in range(n_actions):
            logit = zero
            for k in present[:count]:
                logit += weight[lane, a, k] * observation[i, k]
            probs[a] = logit
        log_prob, normaliser = _exponentials(probs, chosen, zero)
        total[lane] += factor * log_prob
        for a in range(n_actions):
            share = factor * (np.float64(a == chosen) - np.float64(probs[a] / normaliser))
            for k in present[:count]:
                gradient[lane, a, k] += share * observation[i, k]
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _score(observation, action, advantage, trial, weight, total, gradient):
    trials, n_actions, n_features = weight.shape
    probs = np.empty(n_actions, dtype=weight.dtype)
    slope = np.empty((n_actions, n_features))
    zero = np.zeros(1, dtype=weight.dtype)[0]
    i = 0
    while i < len(action):
        lane = trial[i]
        if not 0 <= lane < trials:
            return False
        slope[:] = gradient[lane]  # so that sums do not depend on whose frames lie between
        value = total[lane]
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
def _score_two(n_features: int) -> Callable[..., bool]:
    """For two actions: d = logit of the other − logit of the chosen; log π = −log(1 + e^d)."""

    @nb.njit(cache=True, nogil=True, error_model="numpy")
    def score(observation, action, advantage, trial, weight, total, gradient):
        trials = len(weight)
        one = np.ones(1, dtype=weight.dtype)[0]
        zero = one - one
        own_difference, own_slope = np.empty(n_features, weight.dtype), np.empty(n_features)
        difference, slope = borrow(own_difference), borrow(own_slope)
        observation, weight, gradient = borrow(observation), borrow(weight), borrow(gradient)
        valid = True
        i = 0
        while i < len(action):
            lane = trial[i]
            if not 0 <= lane < trials:
                return False
            for k in range(n_features):
                difference[k] = weight[lane, 1, k] - weight[lane, 0, k]
                slope[k] = gradient[lane, 1, k]
            value = total[lane]
            while i < len(action) and trial[i] == lane:
                valid &= 0 <= action[i] < 2
                d = difference[0] * observation[i, 0]
                for k in range(1, n_features):
                    d += difference[k] * observation[i, k]
                second = action[i] == 1
                d = -d if second else d
                small = np.exp(-abs(d))  # never overflows
                whole = one + small
                factor = np.float64(advantage[i])
                value -= factor * (np.log(whole) + max(d, zero))
                other = factor * ((small if d < zero else one) / whole)  # times π(other)
                other = other if second else -other
                for k in range(n_features):
                    slope[k] += other * observation[i, k]
                i += 1
            total[lane] = value
            for k in range(n_features):
                gradient[lane, 1, k] = slope[k]
                gradient[lane, 0, k] = -slope[k]
        own_difference[0] = own_slope[0]  # keeps them alive to here
        return valid

    return score
