"""The flat frames of whole episodes, and quantities derived from them."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from trl_explore.numerics.layers import lane_sum
from trl_explore.numerics.returns import return_to_go


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
        return since(self.starts)

    @cached_property
    def discount(self) -> Tensor:
        """γ^t [frames], as products in a fixed order.

        The vectorised power differs in its last bit with the place of a number in the batch.
        """
        count = int(self.step.max()) if len(self) else 0
        powers = np.multiply.accumulate(np.array([1.0, *[self.gamma] * count]))
        return torch.from_numpy(powers).to(self.step.device)[self.step].to(self.reward.dtype)

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


def since(starts: Tensor) -> Tensor:
    """The number of entries since the last start [n] int64, for bool ``starts`` [n]."""
    place = torch.arange(len(starts), device=starts.device)
    return place - torch.where(starts, place, 0).cummax(0).values
