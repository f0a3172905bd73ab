"""The base class of baselines, a number, and means of returns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, final

import torch
from torch import Tensor, nn
from torchrl.envs import EnvBase

from trl_explore.checks import check_number, withdraw
from trl_explore.objectives.episodes import Episodes, since


class Baseline(nn.Module, ABC):
    """b_t, subtracted from the return G_t before it weights ∇log π(a_t|s_t).

    A baseline that does not depend on the action a_t changes the variance of the gradient, but not
    its expectation (Williams 1992, §4; Sutton & Barto, §13.4). It uses only the trial's own data.
    It learns in ``step``, after the update, so a frame's baseline never contains the frame's own
    return.

    Keep state in buffers, in parameters, or as plain arrays in ``get_extra_state``.

    Attributes:
        learns_from_data: whether ``step`` learns from the episodes of an iteration. True in a class
            that overrides ``step``, unless the class declares it.
    """

    learns_from_data: ClassVar[bool] = False
    lr: float | None = None
    """The learning rate of the baseline's own parameters, if it has any."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        withdraw(cls, "learns_from_data", True, ["step"])

    def bind(self, env: EnvBase) -> None:
        """Allocate for the environment and its number of trials; called before training."""

    @abstractmethod
    def forward(self, episodes: Episodes) -> Tensor | float:
        """b_t of every frame [frames], without gradient, or one number for all."""

    def loss(self, episodes: Episodes) -> Tensor | None:
        """The loss of the baseline's own parameters [trials]; None if it has none."""
        return None

    def step(self, episodes: Episodes) -> None:
        """Learn from the episodes of an iteration, after its update."""


@final
class Constant(Baseline):
    """b_t = value, one number for all frames; 0 in the thesis.

    Args:
        value: the number.

    Raises:
        ValueError: if the value is not a finite number.

    Example:
        >>> Constant(20.0).value
        20.0
    """

    def __init__(self, value: float = 0.0) -> None:
        super().__init__()
        self.value = check_number("baseline", value)

    def forward(self, episodes: Episodes) -> float:
        """The number."""
        return self.value


class EpisodeMean(Baseline):
    """b_t = mean of G_j over the frames j of the same episode.

    Biased: the mean contains G_t itself and rewards that depend on a_t, so the subtracted term
    does not have mean 0.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> done, trial = torch.tensor([False, True]), torch.zeros(2).long()
        >>> EpisodeMean()(Episodes(TensorDict({}, [2]), torch.ones(2), done, trial, 1, 1.0))
        tensor([1.5000, 1.5000])
    """

    def forward(self, episodes: Episodes) -> Tensor:
        """The mean return of the frame's episode [frames]."""
        total = episodes.by_episode(episodes.returns)
        count = episodes.index.bincount(minlength=len(total))
        return (total / count)[episodes.index]


class LeaveOneOut(Baseline):
    """b_t = mean of G_t over the other episodes of the trial in the same iteration, at step t.

    An episode that ends before t counts as G_t = 0. Unbiased: the other episodes are independent of
    the action (Kool, van Hoof & Welling 2019, "Buy 4 REINFORCE samples, get a
    baseline for free!", eq. 8, here for every step). Needs at least two episodes per update.

    Raises:
        ValueError: when called, if a trial has a single episode.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> reward, done = torch.tensor([4.0, 2.0]), torch.tensor([True, True])
        >>> two = Episodes(TensorDict({}, [2]), reward, done, torch.zeros(2).long(), 1, 1.0)
        >>> LeaveOneOut()(two)
        tensor([2., 4.])
    """

    def forward(self, episodes: Episodes) -> Tensor:
        """The mean return of the other episodes at the frame's step [frames]."""
        if not len(episodes):
            return episodes.reward
        count = episodes.episodes_of_trial[episodes.trial]
        if bool((count < 2).any()):
            raise ValueError(
                "baseline leave_one_out needs at least two episodes of every trial in the data: "
                "episodes_per_update >= 2"
            )
        steps = int(episodes.step.max()) + 1
        returns = episodes.returns
        grid = returns.new_zeros(len(episodes.owner), steps)
        grid[episodes.index, episodes.step] = returns
        total = returns.new_zeros(episodes.trials, steps).index_add_(0, episodes.owner, grid)
        others = total[episodes.trial, episodes.step] - returns
        return others / (count - 1).to(returns.dtype)


class StepMean(Baseline):
    """b_t = mean of G_t over earlier episodes of the same trial that reached step t.

    Unbiased: it depends only on earlier episodes (Greensmith, Bartlett & Baxter 2004, §3, for
    baselines in general). At a step that no earlier episode has reached, b_t = 0.

    Args:
        decay: λ in [0, 1]; an episode j episodes ago has weight λ^j. 1 gives the plain mean; less
            than 1 forgets the episodes of earlier, worse policies.

    Raises:
        ValueError: if ``decay`` is not in [0, 1].

    Example:
        >>> from tensordict import TensorDict
        >>> done, trial = torch.tensor([False, True]), torch.zeros(2).long()
        >>> episodes = Episodes(TensorDict({}, [2]), torch.ones(2), done, trial, 1, 1.0)
        >>> baseline = StepMean()
        >>> baseline.step(episodes)
        >>> baseline(episodes)
        tensor([2., 1.])
    """

    def __init__(self, decay: float = 1.0) -> None:
        super().__init__()
        self.decay = check_number("decay", decay, 0, 1)
        self.total: Tensor
        self.count: Tensor
        for name in ("total", "count"):  # of the returns [trials, steps]
            self.register_buffer(name, torch.zeros(0, 0, dtype=torch.float64))

    def forward(self, episodes: Episodes) -> Tensor:
        """The running mean at the frame's step [frames]."""
        if not len(episodes):
            return episodes.reward
        self._reserve(episodes)
        place = episodes.trial, episodes.step
        mean = self.total[place] / self.count[place].clamp(min=1e-300)
        return mean.to(episodes.reward.dtype)

    def step(self, episodes: Episodes) -> None:
        """Add the episodes of an iteration, in order."""
        if not len(episodes):
            return
        self._reserve(episodes)
        rank = _rank(episodes.owner)
        for j in range(int(rank.max()) + 1):  # the j-th episode of every trial
            seen = episodes.owner[rank == j]
            self.total[seen] *= self.decay
            self.count[seen] *= self.decay
            frames = rank[episodes.index] == j
            place = episodes.trial[frames], episodes.step[frames]
            self.total[place] += episodes.returns[frames].double()
            self.count[place] += 1

    def _reserve(self, episodes: Episodes) -> None:
        """Grow the arrays for more trials or longer episodes."""
        trials, steps = self.total.shape
        longest = int(episodes.step.max()) + 1
        if episodes.trials > trials or longest > steps:
            grown = max(episodes.trials, trials), max(longest, min(2 * steps, longest + 500), steps)
            for name in ("total", "count"):
                new = getattr(self, name).new_zeros(grown)
                new[:trials, :steps] = getattr(self, name)
                setattr(self, name, new)

    def _load_from_state_dict(
        self, state_dict: Mapping[str, Any], prefix: str, *args: Any, **options: Any
    ) -> None:
        for name in ("total", "count"):  # which have grown with the data
            if prefix + name in state_dict:
                shape = state_dict[prefix + name].shape
                setattr(self, name, getattr(self, name).new_zeros(shape))
        super()._load_from_state_dict(state_dict, prefix, *args, **options)


def _rank(owner: Tensor) -> Tensor:
    """The index of every episode within its trial [episodes]."""
    first = torch.ones_like(owner, dtype=torch.bool)
    first[1:] = owner[1:] != owner[:-1]
    return since(first)
