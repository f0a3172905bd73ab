"""Episodes from data in the layouts of TorchRL's collectors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor

from trl_explore.objectives.episodes import Episodes, Layout
from trl_explore.strategies.frames import read


@dataclass
class Keys:
    """The entries of the data that ``ReinforceLoss.set_keys`` can rename.

    Args:
        action: a_t.
        reward: r_t, in "next".
        done: whether the episode ended, in "next".
        trial: the trial.
        sample_log_prob: log μ(a_t|s_t).
        traj_ids: TorchRL's identity of the episode.
    """

    action: NestedKey = "action"
    reward: NestedKey = "reward"
    done: NestedKey = "done"
    trial: NestedKey = "trial"
    sample_log_prob: NestedKey = "action_log_prob"
    traj_ids: NestedKey = ("collector", "traj_ids")


def read_episodes(
    tensordict: TensorDictBase,
    keys: Keys,
    mask_keys: Iterable[NestedKey],
    trials: int | None,
    gamma: float,
) -> Episodes:
    """The episodes in data of a layout that ``ReinforceLoss`` describes.

    ``mask_keys`` are entries that mark the valid frames, if the data have them.

    Raises:
        KeyError: if an entry is missing.
        ValueError: if an entry has a shape or a type that does not fit.
    """
    tensordict = _with_batch(tensordict, keys)
    batch = tensordict.batch_size
    reward = read(tensordict, unravel_key(("next", keys.reward))).detach()
    if reward.dtype not in (torch.float32, torch.float64):
        reward = reward.float()  # sums of integers truncate, those of half precision round
    agents = _agents(reward, keys.reward, batch)
    columns = torch.Size((*batch, agents)) if agents > 1 else batch
    reward = _shaped(reward, keys.reward, columns)
    done = read(tensordict, unravel_key(("next", keys.done))).bool()
    shared = agents > 1 and done.numel() == batch.numel()
    done = _shaped(done, keys.done, batch, agents) if shared else _shaped(done, keys.done, columns)
    trial = tensordict.get(keys.trial, None)
    if trial is None:
        trial = _rows(batch, trials, reward.device)
        tensordict = tensordict.copy().set(keys.trial, trial)
    if trial.is_floating_point() or trial.dtype is torch.bool:
        raise ValueError(f"{keys.trial!r} must hold integers, got {trial.dtype}")
    trial = _shaped(trial, keys.trial, batch).long()
    if trials is None:
        trials = int(trial.max()) + 1 if trial.numel() else 0
    ends, mask = _cuts(tensordict, keys, mask_keys, done.device)
    if ends is not None:
        done = done | (ends if agents == 1 else ends.unsqueeze(-1))
    flat: list[Any] = [tensordict, reward, done, trial]
    if mask is not None:
        flat = [x[mask] for x in flat]
    elif len(batch) > 1:
        flat = [x.reshape(batch.numel(), *x.shape[len(batch) :]) for x in flat]
    frames, reward, done, trial = flat
    if agents > 1:
        agent = torch.arange(agents, device=trial.device).unsqueeze(-1)
        trial, trials = (trial * agents + agent).reshape(-1), trials * agents
        reward, done = reward.T.reshape(-1), done.T.reshape(-1)
    return Episodes(frames, reward, done, trial, trials, gamma, Layout(batch, agents, mask))


def _with_batch(tensordict: TensorDictBase, keys: Keys) -> TensorDictBase:
    """The data; without a batch size, as in a call with keywords, it is that of the reward."""
    if tensordict.batch_dims:
        return tensordict
    shape = read(tensordict, unravel_key(("next", keys.reward))).shape
    tensordict = tensordict.copy()
    tensordict.batch_size = shape[:-1] if shape[-1:] == (1,) else shape  # pyright: ignore
    return tensordict if tensordict.batch_dims else tensordict.unsqueeze(0)


def _agents(reward: Tensor, key: NestedKey, batch: torch.Size) -> int:
    """The number of agents with a reward of their own; a group of agents has a nested key."""
    rest = reward.shape[len(batch) :]
    grouped = isinstance(key, tuple) and reward.shape[: len(batch)] == batch
    if grouped and len(rest) in (1, 2) and rest[1:] in ((), (1,)):
        return rest[0]
    return 1


def _shaped(values: Tensor, key: NestedKey, batch: torch.Size, agents: int = 1) -> Tensor:
    """``values`` as [*batch]; with several agents, repeated for each."""
    if values.shape == (*batch, 1):
        values = values.squeeze(-1)
    elif values.numel() != batch.numel():
        raise ValueError(
            f"{key!r} is {list(values.shape)}, but the data are {list(batch)}: "
            "there must be one number per frame"
        )
    elif values.shape != batch:
        values = values.reshape(batch)
    return values if agents == 1 else values.unsqueeze(-1).expand(*batch, agents)


def _rows(batch: torch.Size, trials: int | None, device: torch.device) -> Tensor:
    """The trial of every frame [*batch] if the data do not say it: their row; or 0, if one."""
    rows = batch[:-1].numel()
    if trials == 1:
        return torch.zeros(batch, dtype=torch.int64, device=device)
    if trials is not None and rows > trials:
        raise ValueError(f"trials is {trials}, but the data have {rows} rows and no trial")
    return torch.arange(rows, device=device).reshape(*batch[:-1], 1).expand(batch)


def _cuts(
    tensordict: TensorDictBase, keys: Keys, mask_keys: Iterable[NestedKey], device: torch.device
) -> tuple[Tensor | None, Tensor | None]:
    """Where episodes end besides "done", and which frames are valid, both [*batch] or None.

    A row ends, padding follows, or TorchRL's identity of the trajectory changes: it is −1 for
    frames that a worker did not deliver.
    """
    batch = tensordict.batch_size
    masks = [
        _shaped(mask, key, batch).bool()
        for key in mask_keys
        if (mask := tensordict.get(key, None)) is not None
    ]
    trajectory = tensordict.get(keys.traj_ids, None)
    if trajectory is not None:
        trajectory = _shaped(trajectory, keys.traj_ids, batch)
        if bool((trajectory == -1).any()):
            masks.append(trajectory != -1)
    mask = torch.stack(masks).all(0) if masks else None
    if trajectory is None and mask is None and len(batch) == 1:
        return None, None
    ends = torch.zeros(batch, dtype=torch.bool, device=device)
    ends[..., -1:] = True
    if trajectory is not None:
        ends[..., :-1] |= trajectory[..., 1:] != trajectory[..., :-1]
    if mask is not None:
        ends[..., :-1] |= ~mask[..., 1:]
    return ends, mask
