"""The data of an iteration: flat frames of whole episodes, and quantities derived from them."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Any, Protocol

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from trl_explore.numerics.returns import return_to_go
from trl_explore.numerics.score import lane_sum


class Episodes:
    """Frames of whole episodes [frames], one episode after another, and derived quantities.

    Every sum runs over the frames of one episode or one trial, in order, so trials do not affect
    each other.

    Args:
        tensordict: the frames, with all their entries [frames].
        reward: r [frames].
        done: whether the frame is the last one of its episode [frames].
        trial: [frames] int64 in [0, trials); an episode also ends where it changes.
        trials: the number of trials.
        gamma: discount γ in [0, 1].

    Example:
        >>> from tensordict import TensorDict
        >>> reward, done = torch.ones(3), torch.tensor([False, True, True])
        >>> episodes = Episodes(TensorDict({}, [3]), reward, done, torch.zeros(3).long(), 1, 0.5)
        >>> episodes.returns.tolist(), episodes.step.tolist(), episodes.index.tolist()
        ([1.5, 1.0, 1.0], [0, 1, 0], [0, 0, 1])
    """

    def __init__(
        self,
        tensordict: TensorDictBase,
        reward: Tensor,
        done: Tensor,
        trial: Tensor,
        trials: int,
        gamma: float,
    ) -> None:
        self.tensordict, self.reward, self.done = tensordict, reward, done
        self.trial, self.trials, self.gamma = trial, trials, gamma

    def __len__(self) -> int:
        return len(self.reward)

    def to_go(self, reward: Tensor) -> Tensor:
        """Σ_{j ≥ t} γ^{j−t} x_j, to the end of the episode, for any x = ``reward`` [frames]."""
        return return_to_go(reward, self.done, self.gamma, self.trial)

    @cached_property
    def returns(self) -> Tensor:
        """G_t = Σ_{j ≥ t} γ^{j−t} r_j [frames]."""
        return self.to_go(self.reward)

    @cached_property
    def ends(self) -> Tensor:
        """Whether the frame is the last one of its episode, done or cut off [frames]."""
        ends = self.done.clone()
        ends[:-1] |= self.trial[1:] != self.trial[:-1]
        ends[-1:] = True
        return ends

    @cached_property
    def starts(self) -> Tensor:
        """Whether the frame is the first one of its episode [frames]."""
        return torch.cat([self.ends.new_ones(min(1, len(self))), self.ends[:-1]])

    @cached_property
    def index(self) -> Tensor:
        """The index of the frame's episode in the data [frames] int64."""
        return self.starts.cumsum(0) - 1

    @cached_property
    def step(self) -> Tensor:
        """t, the index of the frame within its episode [frames] int64."""
        place = torch.arange(len(self), device=self.done.device)
        return place - torch.where(self.starts, place, 0).cummax(0).values

    @cached_property
    def owner(self) -> Tensor:
        """The trial of every episode [episodes] int64."""
        return self.trial[self.starts]

    def cumulated(self, values: Tensor) -> Tensor:
        """Σ_{j ≤ t} x_j from the start of the episode, for any x = ``values`` [frames]."""
        return return_to_go(values.flip(0), self.starts.flip(0), 1.0).flip(0)

    def by_episode(self, values: Tensor) -> Tensor:
        """The sums of ``values`` [frames] over every episode [episodes]."""
        return lane_sum(values, self.index, len(self.owner))

    def by_trial(self, values: Tensor) -> Tensor:
        """The sums of ``values`` [frames] over every trial [trials]; 0 where it has no frames."""
        return lane_sum(values, self.trial, self.trials)

    def trial_mean(self, values: Tensor) -> Tensor:
        """The means of ``values`` [frames] over every trial [trials]; 0 where it has no frames."""
        return self.by_trial(values) / self.frames_of_trial.clamp(min=1).to(values.dtype)

    @cached_property
    def frames_of_trial(self) -> Tensor:
        """The number of frames of every trial [trials] int64."""
        return torch.bincount(self.trial, minlength=self.trials)

    @cached_property
    def episodes_of_trial(self) -> Tensor:
        """The number of episodes of every trial [trials] int64."""
        return torch.bincount(self.owner, minlength=self.trials)


class Keys(Protocol):
    """The names of the entries that ``read_episodes`` reads."""

    reward: NestedKey
    done: NestedKey
    trial: NestedKey


def read_episodes(
    tensordict: TensorDictBase,
    keys: Keys,
    mask_keys: Iterable[NestedKey],
    trials: int | None,
    gamma: float,
) -> tuple[Episodes, Tensor | None]:
    """Flat frames, and the mask [*batch] that selects them from the data; None: all.

    Args:
        tensordict: data in a layout that ``ReinforceLoss`` describes.
        keys: the names of the entries.
        mask_keys: entries that mark the valid frames; each is optional.
        trials: the number of trials; None: the largest "trial" in the data plus one.
        gamma: discount γ.

    Raises:
        KeyError: if an entry is missing.
    """
    after = entry(tensordict, "next")
    reward = entry(after, keys.reward).detach().squeeze(-1)
    if reward.dtype not in (torch.float32, torch.float64):
        reward = reward.float()  # sums of integers truncate, those of half precision round
    done = entry(after, keys.done).squeeze(-1)
    trial = tensordict.get(keys.trial, None)
    if trial is None:
        rows = reward.shape[:-1]
        trial = torch.arange(rows.numel(), device=reward.device).reshape(*rows, 1)
        trial = trial.expand(reward.shape)
    if trials is None:
        trials = int(trial.max()) + 1 if trial.numel() else 0
    masks = [mask for key in mask_keys if (mask := tensordict.get(key, None)) is not None]
    mask = torch.stack([mask.reshape(done.shape) for mask in masks]).all(0) if masks else None
    if reward.ndim == 1 and mask is None:
        return Episodes(tensordict, reward, done, trial, trials, gamma), None
    # A row, or the frames before padding, may be cut off before the episode is done.
    done = done.clone()
    done[..., -1:] = True
    if mask is not None:
        done[..., :-1] |= ~mask[..., 1:]
    columns: list[Any] = [tensordict, reward, done, trial]
    flat = [x.reshape(-1) if mask is None else x[mask] for x in columns]
    return Episodes(flat[0], flat[1], flat[2], flat[3], trials, gamma), mask


def entry(tensordict: TensorDictBase, key: NestedKey) -> Any:
    """The entry of the data under ``key``.

    Raises:
        KeyError: if it is missing.
    """
    value = tensordict.get(key, None)
    if value is None:
        raise KeyError(f"missing key: {key!r}")
    return value
