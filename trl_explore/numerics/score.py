"""The sum that every policy gradient is made of, for a linear-softmax policy, in one pass."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from trl_explore.numerics.linear import lane_linear
from trl_explore.numerics.log_prob import categorical_log_prob
from trl_explore.numerics.score_kernels import score_kernel
from trl_explore.numerics.score_two import score_two
from trl_explore.numerics.threads import by_trial, check_frames, fits

NOTHING = np.zeros(0, dtype=np.bool_)


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
    if not serves(observation, weight, advantage):
        _check(observation, weight, action, advantage, trial)
        logits = lane_linear(observation, weight, trial)
        return lane_sum(categorical_log_prob(logits, action) * advantage, trial, len(weight))
    score: Any = _LinearSoftmaxScore.apply(observation, weight, action, advantage, trial)
    return score


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
        score, ctx.gradient = linear_softmax_gradient(observation, weight, action, advantage, trial)
        return score

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[None, Tensor, None, None, None]:
        return None, grad.reshape(-1, 1, 1) * ctx.gradient, None, None, None


def serves(observation: Tensor, weight: Tensor, advantage: Tensor) -> bool:
    """Whether ``linear_softmax_gradient`` does: on the CPU, in one dtype, for the weights alone."""
    return fits(observation, weight, advantage) and not observation.requires_grad


def linear_softmax_gradient(
    observation: Tensor,
    weight: Tensor,
    action: Tensor,
    advantage: Tensor,
    trial: Tensor,
    scale: float = 1.0,
    into: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """S of ``linear_softmax_score`` and ∂S/∂W [trials, n_actions, n_features], without autograd.

    Both are multiplied with ``scale``, in the precision of the weights. The gradient is added to
    ``into``, which is returned, if that is given.

    Arguments and errors are those of ``linear_softmax_score``, as far as ``serves`` says so.

    Example:
        >>> x, w, one = torch.ones(1, 1), torch.zeros(1, 2, 1), torch.tensor([1])
        >>> score, gradient = linear_softmax_gradient(x, w, one, torch.ones(1), one - 1)
        >>> gradient.tolist()
        [[[-0.5], [0.5]]]
    """
    _check(observation, weight, action, advantage, trial)
    frames = [x.contiguous().numpy() for x in (observation, action, advantage, trial)]
    found = _sums(frames[:3], frames[3], weight, (scale, 0), into=into)
    if found is None:
        order = np.argsort(frames[3], kind="stable")
        *first, trials = (array[order] for array in frames)
        found = _sums(first, trials, weight, (scale, 0), into=into)
    if found is None:
        trials, n_actions, _ = weight.shape
        raise IndexError(f"an action is not in [0, {n_actions}) or a trial not in [0, {trials})")
    return found


def _sums(
    frames: list[NDArray[Any]],
    trial: NDArray[Any],
    weight: Tensor,
    numbers: tuple[float, float],
    gamma: float = 1.0,
    into: Tensor | None = None,
) -> tuple[Tensor, Tensor] | None:
    """S and its gradient; None where trials do not ascend, or something is out of range.

    The frames are observation, action and advantage; for two actions, reward and done may follow,
    and no advantages be there.
    """
    w = weight.detach().contiguous().numpy()
    sums = np.zeros(len(w), w.dtype)
    rows = slice(0, len(w)) if into is None else _rows(trial, len(w))
    w, total = w[rows], sums[rows]
    gradient = np.zeros(w.shape, w.dtype)
    factors = np.array(numbers, w.dtype)
    if w.shape[1] == 2:
        kernel = score_two(w.shape[2], w.dtype == np.float32)
        frames = [*frames, np.zeros(0, w.dtype), NOTHING] if len(frames) == 3 else frames
        shared = w, rows.start, factors, gamma, total, gradient
    else:
        kernel = score_kernel(w.shape, frames[0])
        shared = w, rows.start, factors, total, gradient
    if not by_trial(kernel, [*frames, trial], shared, ordered=True):
        return None
    slope = torch.from_numpy(gradient)
    if into is not None:
        into[rows].add_(slope)
    return torch.from_numpy(sums), slope if into is None else into


def _rows(trial: NDArray[Any], trials: int) -> slice:
    """Where the rows of ascending trials lie: some of thousands are treated as if there were few.

    All rows, if they are most of them, or the trials do not ascend.
    """
    if len(trial) and 0 <= trial[0] <= trial[-1] < trials:
        first, end = int(trial[0]), int(trial[-1]) + 1
        if 2 * (end - first) <= trials:
            return slice(first, end)
    return slice(0, trials)


def linear_softmax_reinforce(
    observation: Tensor,
    weight: Tensor,
    action: Tensor,
    reward: Tensor,
    done: Tensor,
    trial: Tensor,
    *,
    gamma: float,
    baseline: float,
    scale: float,
    into: Tensor | None = None,
) -> tuple[Tensor, Tensor] | None:
    """What ``linear_softmax_gradient`` gives for A_t = G_t − b, in one pass over the frames.

    It makes the advantages of ``return_to_go`` itself, in the same operations.

    Args:
        observation: x [frames, n_features].
        weight: W [trials, n_actions, n_features].
        action: a [frames] int64.
        reward: r [frames].
        done: whether the frame is the last one of its episode [frames].
        trial: [frames] int64.
        gamma: discount γ.
        baseline: b.
        scale: a factor of S and its gradient.
        into: what the gradient is added to, and returned, if that is given.

    Returns:
        S and its gradient; None where the trials do not ascend, something is out of range, or
        there are not two actions.

    Raises:
        ValueError: if the shapes do not fit each other.
    """
    if weight.shape[1] != 2:
        return None
    check_frames(reward.shape, done=done)
    _check(observation, weight, action, reward, trial)
    columns = [x.contiguous().numpy() for x in (observation, action, reward[:0], reward, done)]
    return _sums(columns, trial.contiguous().numpy(), weight, (scale, baseline), gamma, into)


def _check(
    observation: Tensor, weight: Tensor, action: Tensor, advantage: Tensor, trial: Tensor
) -> None:
    check_frames(observation.shape[:1], action=action, advantage=advantage, trial=trial)
    if observation.shape[1] != weight.shape[2]:
        raise ValueError(
            f"observation has {observation.shape[1]} features, the weights {weight.shape[2]}"
        )
