"""The base class of baselines, and a number as a baseline."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, final

from torch import Tensor, nn
from torchrl.envs import EnvBase

from trl_explore.checks import check_number, settle
from trl_explore.objectives.episodes import Episodes


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
        settle(cls, "learns_from_data", True, ["step"])

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


def as_baseline(value: Baseline | float) -> Baseline:
    """A number as a ``Constant``; a baseline unchanged."""
    return value if isinstance(value, Baseline) else Constant(value)
