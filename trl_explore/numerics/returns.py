"""Discounted returns."""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from trl_explore.envs.kernels.kernel import kernel_function
from trl_explore.numerics import bell as bell_module
from trl_explore.numerics import runs
from trl_explore.numerics.bell import ring
from trl_explore.numerics.compiled import compiled
from trl_explore.numerics.runs import end_of_episode, end_of_run
from trl_explore.numerics.threads import by_trial, check_frames, fits


def return_to_go(reward: Tensor, done: Tensor, gamma: float, trial: Tensor | None = None) -> Tensor:
    """G_t = r_t + γ · G_{t+1}, with G_{t+1} = 0 behind a frame that is done, and behind the last.

    Time is the last dimension; any number of episodes may follow each other along it. This is
    ``discount_rewards`` of the thesis (appendix A.2). A truncated episode is cut where it was
    truncated, as in the thesis: no value is bootstrapped in its place.

    Args:
        reward: [*batch, time].
        done: [*batch, time] bool, True on the last frame of an episode.
        gamma: discount γ in [0, 1].
        trial: [time] int64, for one row of several trials' frames: G_{t+1} = 0 where it changes.

    Returns:
        [*batch, time], in the dtype of ``reward``.

    Raises:
        ValueError: if the shapes do not fit each other.

    Example:
        >>> done = torch.tensor([False, True, False])
        >>> return_to_go(torch.tensor([1.0, 1.0, 4.0]), done, 0.5).tolist()
        [1.5, 1.0, 4.0]
    """
    check_frames(reward.shape, done=done)
    if trial is not None:
        if reward.ndim != 1:
            raise ValueError(f"trial goes with one row of frames, got {list(reward.shape)}")
        check_frames(reward.shape, trial=trial)
    if fits(reward):
        if trial is None:
            rows = torch.arange(reward.shape[:-1].numel()).unsqueeze(-1)
            trial = rows.expand(-1, reward.shape[-1]).reshape(-1)
        out = torch.empty(reward.shape, dtype=reward.dtype)
        frames = (reward.detach().reshape(-1), done.reshape(-1), out.view(-1), trial.contiguous())
        by_trial(_by_run, [column.numpy() for column in frames], (gamma,))
        return out
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


_1, _2, _3, _4, _5, _6, _7 = map(np.uint64, range(1, 8))


@compiled(runs, bell_module)
def _by_run(reward, done, out, trial, gamma, bell):
    ring(bell)
    start = 0
    while start < len(reward):
        end = end_of_run(trial, start)
        run_returns(reward[start:end], done[start:end], out[start:end], gamma)
        start = end
    return True


@kernel_function
def run_returns(reward, done, out, gamma):
    """Write the returns of one trial's frames, formed in double.

    For float32 rewards from eight frames to the eight before: with l_t, the sum over the rest of
    the block of t, and G, the return behind the block, j frames after t: G_t = l_t + γ^j G. Only
    that step waits for the block behind. An episode's blocks begin with its first frame.
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
            t = np.uint64(place)  # see runs
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
