"""The data of an iteration: flat frames of whole episodes, and quantities derived from them."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from trl_explore.numerics.returns import return_to_go
from trl_explore.numerics.score import lane_sum
from trl_explore.strategies.strategy import read


class Layout(NamedTuple):
    """How the data hold the frames: their batch, the number of agents, and the valid frames."""

    batch: torch.Size
    agents: int = 1
    mask: Tensor | None = None


class Episodes:
    """Frames of whole episodes [frames], one episode after another, and derived quantities.

    Every sum runs over the frames of one episode or one trial, in order, so trials do not affect
    each other. In the data of several agents, the frames of the first agent are followed by those
    of the second, and so on; every agent of a trial then counts as a trial of its own,
    ``trial · agents + agent``, and ``trials`` is their number.

    Args:
        tensordict: the data of the frames, with all their entries.
        reward: r [frames].
        done: whether the frame is the last one of its episode [frames].
        trial: [frames] int64 in [0, trials); an episode also ends where it changes.
        trials: the number of trials.
        gamma: discount γ in [0, 1].
        layout: how the data hold the frames; None: as they are here.

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
        layout: Layout | None = None,
    ) -> None:
        self.tensordict, self.reward, self.done = tensordict, reward, done
        self.trial, self.trials, self.gamma = trial, trials, gamma
        self.layout = layout or Layout(reward.shape)

    def __len__(self) -> int:
        return len(self.reward)

    def flat(self, values: Tensor) -> Tensor:
        """One number per frame [frames]: the sum of ``values`` [n, ...] of the n data.

        With several agents, ``values`` is [n, agents, ...], and they stay apart.

        Raises:
            ValueError: if ``values`` has another shape.
        """
        agents = self.layout.agents
        n = len(self) // agents
        expected = (n,) if agents == 1 else (n, agents)
        if values.shape[: len(expected)] != expected:
            raise ValueError(
                f"a distribution gives {list(values.shape)} numbers, not {list(expected)}: "
                "one per frame, or one per frame and agent"
            )
        if values.ndim > len(expected):
            values = values.flatten(len(expected)).sum(-1)
        return values if agents == 1 else values.T.reshape(-1)

    def over_agents(self, values: Tensor) -> Tensor:
        """The sums over the agents of ``values`` [trials · agents], if there are several."""
        agents = self.layout.agents
        return values if agents == 1 else values.reshape(-1, agents).sum(-1)

    def restore(self, values: Tensor) -> Tensor:
        """``values`` [frames] as [*batch], or [*batch, agents] with several; 0 for padding."""
        batch, agents, mask = self.layout
        columns = values.reshape(agents, -1).T
        shape = (*batch, agents) if agents > 1 else batch
        if mask is None:
            return columns.reshape(shape)
        out = values.new_zeros(*batch, agents)
        out[mask] = columns
        return out.reshape(shape)

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
    traj_ids: NestedKey


def read_episodes(
    tensordict: TensorDictBase,
    keys: Keys,
    mask_keys: Iterable[NestedKey],
    trials: int | None,
    gamma: float,
) -> Episodes:
    """The episodes in data of a layout that ``ReinforceLoss`` describes.

    Args:
        tensordict: the data [*batch].
        keys: the names of the entries.
        mask_keys: entries that mark the valid frames; each is optional.
        trials: the number of trials; None: the largest "trial" in the data plus one.
        gamma: discount γ.

    Raises:
        KeyError: if an entry is missing.
        ValueError: if an entry has a shape or a type that does not fit.
    """
    tensordict = _with_batch(tensordict, keys)
    after: Any = read(tensordict, "next")
    batch = tensordict.batch_size
    reward = read(after, keys.reward).detach()
    if reward.dtype not in (torch.float32, torch.float64):
        reward = reward.float()  # sums of integers truncate, those of half precision round
    agents = _agents(reward, keys.reward, batch)
    columns = torch.Size((*batch, agents)) if agents > 1 else batch
    reward = _shaped(reward, keys.reward, columns)
    done = read(after, keys.done).bool()
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
    after: Any = read(tensordict, "next")
    shape = read(after, keys.reward).shape
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
