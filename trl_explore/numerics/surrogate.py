"""The surrogate objective Σ A log π of REINFORCE; in one pass for a linear softmax policy."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from trl_explore.numerics.densities import categorical_log_prob
from trl_explore.numerics.dispatch import check_frames, compiled, supports
from trl_explore.numerics.layers import lane_linear, lane_sum

NOTHING = np.zeros(0, dtype=np.bool_)


class FrameArrays(NamedTuple):
    """What REINFORCE reads from flat frames, as arrays.

    Attributes:
        observation: s [frames, n_features].
        action: a [frames] int64.
        reward: r [frames].
        done: whether the frame is the last one of its episode [frames].
        trial: [frames] int64.
    """

    observation: NDArray[Any]
    action: NDArray[np.int64]
    reward: NDArray[Any]
    done: NDArray[np.bool_]
    trial: NDArray[np.int64]


def linear_softmax_surrogate(
    observation: Tensor, weight: Tensor, action: Tensor, advantage: Tensor, trial: Tensor
) -> Tensor:
    """S_k = Σ_{i: trial_i = k} A_i log softmax(W_k x_i)_{a_i}.

    Its gradient, ∂S_k/∂W_k = Σ_i A_i (e_{a_i} − softmax(W_k x_i)) x_iᵀ, is summed in the same pass
    over the frames, so that nothing is stored for the backward pass.

    Args:
        observation: x [frames, n_features].
        weight: W [trials, n_actions, n_features].
        action: a [frames] int64.
        advantage: A [frames], a constant factor of each frame.
        trial: [frames] int64.

    Returns:
        S [trials].

    Raises:
        ValueError: if the shapes do not match.
        IndexError: if an action or trial is out of range.

    Example:
        >>> x, w = torch.ones(3, 1), torch.zeros(2, 2, 1)
        >>> action, trial = torch.tensor([0, 1, 1]), torch.tensor([0, 0, 1])
        >>> total = linear_softmax_surrogate(x, w, action, torch.ones(3), trial)
        >>> (total / torch.tensor(0.5).log()).tolist()
        [2.0, 1.0]
    """
    if not formula_applies(observation, weight, advantage):
        _check(observation, weight, action, advantage, trial)
        return plain_linear_softmax_surrogate(observation, weight, action, advantage, trial)
    total: Any = _LinearSoftmaxSurrogate.apply(observation, weight, action, advantage, trial)
    return total


def plain_linear_softmax_surrogate(
    observation: Tensor, weight: Tensor, action: Tensor, advantage: Tensor, trial: Tensor
) -> Tensor:
    """``linear_softmax_surrogate`` by differentiable operations, for any device and dtype."""
    logits = lane_linear(observation, weight, trial)
    return lane_sum(categorical_log_prob(logits, action) * advantage, trial, len(weight))


class _LinearSoftmaxSurrogate(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        observation: Tensor,
        weight: Tensor,
        action: Tensor,
        advantage: Tensor,
        trial: Tensor,
    ) -> Tensor:
        total, ctx.gradient = linear_softmax_gradient(observation, weight, action, advantage, trial)
        return total

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[None, Tensor, None, None, None]:
        return None, grad.reshape(-1, 1, 1) * ctx.gradient, None, None, None


def formula_applies(observation: Tensor, weight: Tensor, advantage: Tensor) -> bool:
    """Whether ``linear_softmax_gradient`` applies: compiled code, no gradient of observations."""
    return supports(observation, weight, advantage) and not observation.requires_grad


def linear_softmax_gradient(
    observation: Tensor,
    weight: Tensor,
    action: Tensor,
    advantage: Tensor,
    trial: Tensor,
    scale: float = 1.0,
) -> tuple[Tensor, Tensor]:
    """S and ∂S/∂W [trials, n_actions, n_features] of this surrogate, without autograd.

    Both are multiplied by ``scale``, in the precision of the weights. Arguments and errors are
    those of ``linear_softmax_surrogate``. Call it only if ``formula_applies`` is true.

    Example:
        >>> x, w, one = torch.ones(1, 1), torch.zeros(1, 2, 1), torch.tensor([1])
        >>> total, gradient = linear_softmax_gradient(x, w, one, torch.ones(1), one - 1)
        >>> gradient.tolist()
        [[[-0.5], [0.5]]]
    """
    _check(observation, weight, action, advantage, trial)
    frames = [x.contiguous().numpy() for x in (observation, action, advantage, trial)]
    found = _sums(frames[:3], frames[3], weight, scale)
    if found is None:
        order = np.argsort(frames[3], kind="stable")
        *columns, trials = (array[order] for array in frames)
        found = _sums(columns, trials, weight, scale)
    if found is None:
        trials, n_actions, _ = weight.shape
        raise IndexError(
            f"every action must be in [0, {n_actions}) and every trial in [0, {trials})"
        )
    return found


def _sums(
    frames: list[NDArray[Any]],
    trial: NDArray[Any],
    weight: Tensor,
    scale: float,
    baseline: float = 0.0,
    gamma: float = 1.0,
) -> tuple[Tensor, Tensor] | None:
    """S and its gradient; None if trials are not in ascending order or an index is out of range.

    ``frames`` has observation, action and advantage. For two actions, reward and done may follow;
    the advantages are then empty.
    """
    kernels, w = compiled("surrogate"), weight.detach().contiguous().numpy()
    total, gradient = np.zeros(len(w), w.dtype), np.zeros(w.shape, w.dtype)
    factor = np.array([scale], w.dtype)
    if w.shape[1] == 2:
        kernel = kernels.surrogate_two(w.shape[2], w.dtype == np.float32)
        frames = [*frames, np.zeros(0, w.dtype), NOTHING] if len(frames) == 3 else frames
        shift = np.array([baseline], w.dtype)
        valid = kernel(*frames, trial, w, factor, shift, gamma, total, gradient)
    else:
        kernel = kernels.surrogate_kernel(w.shape, frames[0])
        valid = kernel(*frames, trial, w, factor, total, gradient)
    return (torch.from_numpy(total), torch.from_numpy(gradient)) if valid else None


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
) -> tuple[Tensor, Tensor] | None:
    """``linear_softmax_gradient`` with A_t = G_t − b, in one pass over the frames.

    It computes the returns with the same operations as ``return_to_go``.

    Args and errors are those of ``linear_softmax_gradient``, with reward r and done [frames],
    discount γ and baseline b in place of A.

    Returns:
        S and its gradient; None if the trials are not in ascending order or an index is out of
        range.

    Raises:
        ValueError: if the shapes do not match.
    """
    check_frames(reward.shape, done=done)
    _check(observation, weight, action, reward, trial)
    columns = (observation, action, reward, done, trial)
    frames = FrameArrays(*(x.contiguous().numpy() for x in columns))
    return reinforce_of_arrays(frames, weight, gamma, baseline, scale)


def reinforce_of_arrays(
    frames: FrameArrays, weight: Tensor, gamma: float, baseline: float, scale: float
) -> tuple[Tensor, Tensor] | None:
    """``linear_softmax_reinforce`` of arrays whose shapes are known to match."""
    observation, action, reward, done, trial = frames
    if weight.shape[1] == 2:
        columns = [observation, action, reward[:0], reward, done]
        return _sums(columns, trial, weight, scale, baseline, gamma)
    advantage = np.empty_like(reward)
    compiled("returns").returns(reward, done, advantage, trial, gamma)
    advantage -= reward.dtype.type(baseline)
    return _sums([observation, action, advantage], trial, weight, scale)


def _check(
    observation: Tensor, weight: Tensor, action: Tensor, advantage: Tensor, trial: Tensor
) -> None:
    check_frames(observation.shape[:1], action=action, advantage=advantage, trial=trial)
    if observation.shape[1] != weight.shape[2]:
        raise ValueError(
            f"observation has {observation.shape[1]} features, "
            f"but the weights have {weight.shape[2]}"
        )
