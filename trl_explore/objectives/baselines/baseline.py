"""What is subtracted from the return, and the simplest case of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, final

from torch import Tensor, nn
from torchrl.envs import EnvBase

from trl_explore.checks import check_number, settle
from trl_explore.objectives.episodes import Episodes


class Baseline(nn.Module, ABC):
    """b_t, what is subtracted from the return G_t before it weighs ∇log π(a_t|s_t).

    A baseline that does not depend on the action a_t leaves the expected gradient as it is and
    changes its variance (Williams 1992, §4; Sutton & Barto, §13.4). It knows a trial's own data
    only. What it learns, it learns in ``step``, after the update, so that a frame's baseline
    never contains the return of the frame itself.

    State is kept in buffers, in parameters, or in ``get_extra_state`` as plain arrays.

    Attributes:
        learns_from_data: whether ``step`` learns from the episodes of an iteration. True in a class
            that overrides ``step``, unless the class says otherwise.
    """

    learns_from_data: ClassVar[bool] = False
    lr: float | None = None
    """The learning rate of the baseline's own parameters, if it has any."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        settle(cls, "learns_from_data", True, ["step"])

    def bind(self, env: EnvBase) -> None:
        """Learn for which environment and how many trials it is; called before training."""

    @abstractmethod
    def forward(self, episodes: Episodes) -> Tensor | float:
        """b_t of every frame [frames], without gradient, or one number for all."""

    def loss(self, episodes: Episodes) -> Tensor | None:
        """What the baseline's own parameters minimise [trials]; None if it has none."""
        return None

    def step(self, episodes: Episodes) -> None:
        """Learn from the episodes of an iteration, after its update."""


@final
class Constant(Baseline):
    """b_t = value, one number for all frames; 0 in the thesis.

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

    Biased: the mean contains G_t itself, and rewards that a_t led to. What it takes from the
    gradient does not have mean 0.

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


def as_baseline(value: Baseline | float) -> Baseline:
    """A baseline from a number, or as it is."""
    return value if isinstance(value, Baseline) else Constant(value)
