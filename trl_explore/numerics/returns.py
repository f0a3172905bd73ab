"""Discounted returns."""

from __future__ import annotations

import torch
from torch import Tensor

from trl_explore.numerics.dispatch import check_frames, compiled, supports


def return_to_go(reward: Tensor, done: Tensor, gamma: float, trial: Tensor | None = None) -> Tensor:
    """G_t = r_t + γ · G_{t+1}, with G_{t+1} = 0 after a frame that is done, and after the last.

    Time is the last dimension and may hold several episodes in sequence. This is
    ``discount_rewards`` of the thesis (appendix A.2). As in the thesis, the return of a truncated
    episode ends at the truncation, without bootstrapping.

    Args:
        reward: [*batch, time].
        done: [*batch, time] bool, True on the last frame of an episode.
        gamma: discount γ in [0, 1].
        trial: [time] int64, if one row has the frames of several trials: G_{t+1} = 0 where it
            changes.

    Returns:
        [*batch, time], in the dtype of ``reward``.

    Raises:
        ValueError: if the shapes do not match.

    Example:
        >>> done = torch.tensor([False, True, False])
        >>> return_to_go(torch.tensor([1.0, 1.0, 4.0]), done, 0.5).tolist()
        [1.5, 1.0, 4.0]
    """
    check_frames(reward.shape, done=done)
    if trial is not None:
        if reward.ndim != 1:
            raise ValueError(
                f"with trial, reward must have one dimension, got {list(reward.shape)}"
            )
        check_frames(reward.shape, trial=trial)
    if supports(reward):
        if trial is None:
            rows = torch.arange(reward.shape[:-1].numel()).unsqueeze(-1)
            trial = rows.expand(-1, reward.shape[-1]).reshape(-1)
        out = torch.empty(reward.shape, dtype=reward.dtype)
        frames = (reward.detach().reshape(-1), done.reshape(-1), out.view(-1), trial.contiguous())
        compiled("returns").returns(*(column.numpy() for column in frames), gamma)
        return out
    return plain_return_to_go(reward, done, gamma, trial)


def plain_return_to_go(
    reward: Tensor, done: Tensor, gamma: float, trial: Tensor | None = None
) -> Tensor:
    """``return_to_go`` in torch, for any device and dtype."""
    if trial is not None:
        done = done.clone()
        done[:-1] |= trial[1:] != trial[:-1]
    going = (~done).to(reward.dtype)
    out = torch.empty_like(reward)
    after = reward.new_zeros(reward.shape[:-1])
    for t in reversed(range(reward.shape[-1])):
        after = reward[..., t] + gamma * going[..., t] * after
        out[..., t] = after
    return out
