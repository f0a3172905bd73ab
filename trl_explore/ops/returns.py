"""Discounted returns."""

from __future__ import annotations

import numba as nb
import torch
from torch import Tensor


def return_to_go(reward: Tensor, done: Tensor, gamma: float) -> Tensor:
    """G_t = r_t + γ · G_{t+1}, with G_{t+1} = 0 behind a frame that is done, and behind the last.

    Time is the last dimension; any number of episodes may follow each other along it. This is
    ``discount_rewards`` of the thesis (appendix A.2). A truncated episode is cut where it was
    truncated, as in the thesis: no value is bootstrapped in its place.

    Args:
        reward: [*batch, time].
        done: [*batch, time] bool, True on the last frame of an episode.
        gamma: discount γ in [0, 1].

    Returns:
        [*batch, time], in the dtype of ``reward``.

    Example:
        >>> done = torch.tensor([False, True, False])
        >>> return_to_go(torch.tensor([1.0, 1.0, 4.0]), done, 0.5).tolist()
        [1.5, 1.0, 4.0]
    """
    if reward.device.type == "cpu" and reward.dtype in (torch.float32, torch.float64):
        out = torch.empty(reward.shape, dtype=reward.dtype)
        time = max(reward.shape[-1], 1)
        _return_to_go(
            reward.detach().reshape(-1, time).contiguous().numpy(),
            done.reshape(-1, time).contiguous().numpy(),
            gamma,
            out.view(-1, time).numpy(),
        )
        return out
    going = (~done).to(reward.dtype)
    out = torch.empty_like(reward)
    after = torch.zeros_like(reward[..., 0])
    for t in reversed(range(reward.shape[-1])):
        after = reward[..., t] + gamma * going[..., t] * after
        out[..., t] = after
    return out


@nb.njit(cache=True, nogil=True)
def _return_to_go(reward, done, gamma, out):  # pragma: no cover - compiled
    for row in range(reward.shape[0]):
        after = 0.0
        for t in range(reward.shape[1] - 1, -1, -1):
            if done[row, t]:
                after = 0.0
            after = reward[row, t] + gamma * after
            out[row, t] = after
