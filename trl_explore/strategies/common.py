"""What strategies have in common, whatever the actions are."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.envs.utils import ExplorationType, exploration_type


class BaseStrategy(TensorDictModuleBase):
    """A behaviour policy μ(·|s) made from what a target policy writes.

    The ancestor of ``Strategy``, over n actions, and of ``ContinuousStrategy``, over vectors. Here
    are the hooks that a collector calls, the random numbers and the state; nothing knows of the
    distribution.

    Attributes:
        actions: the kind of the actions, "discrete" or "continuous".
        exact: whether "action_log_prob" is the exact log-probability of the action under μ; a
            strategy for which that does not exist writes none.
        differentiable: whether the probability under μ is differentiable in what the policy writes,
            in every iteration.
        noise_size: how many uniform numbers it uses for each frame; where more than one, "noise"
            is [*batch, noise_size].

    Args:
        in_keys: the entries that it reads.
        action_key: the entry to write the action to.
        seed: seed of the module's own generator, used where no "noise" entry is given.
    """

    actions: ClassVar[str]
    exact = True
    differentiable = False
    noise_size = 1

    def __init__(self, in_keys: list[NestedKey], *, action_key: NestedKey, seed: int) -> None:
        super().__init__()
        self.action_key = action_key
        self.in_keys = in_keys  # pyright: ignore[reportAttributeAccessIssue]
        written = [action_key, "action_log_prob"] if self.exact else [action_key]
        self.out_keys = written  # pyright: ignore[reportAttributeAccessIssue]
        self.iteration = 0
        self._generator = torch.Generator().manual_seed(seed)

    @abstractmethod
    def exploiting(self) -> BaseStrategy:
        """The strategy that only exploits: it serves the evaluation of the target policy."""
        raise NotImplementedError(f"{type(self).__name__} does not state who exploits")

    def serve(self, spec: TensorSpec) -> None:
        """Learn which actions the environment takes: called once, by the collector.

        Args:
            spec: the action spec of the environment.

        Raises:
            ValueError: if they are not of the kind that the strategy draws.
        """
        spec = self._leaf(spec)
        if spec.domain != self.actions:
            raise ValueError(
                f"{type(self).__name__} draws {self.actions} actions, "
                f"but those of the environment are {spec.domain}"
            )

    def bind(
        self, policy: TensorDictModuleBase, trials: int, *, seed: int = 0, first_trial: int = 0
    ) -> None:
        """Learn whom the strategy serves: called once, by the collector.

        Args:
            policy: the target policy.
            trials: the number of trials, rows of the policy's parameters.
            seed: seed of the job.
            first_trial: trial index of row 0.

        Raises:
            ValueError: if a parameter has one value per trial, but not for all.
        """

    def begin(self, active: NDArray[np.bool_], episodes: NDArray[np.int64]) -> None:
        """Prepare for the next episode of the active trials.

        Args:
            active: [trials] bool.
            episodes: [trials], the number of every trial's next episode, from 0.
        """

    def step(self, data: TensorDictBase | None = None) -> None:
        """Advance by one iteration: once per update, whatever the batch.

        Args:
            data: the frames of the iteration, for a strategy that learns from them.
        """
        self.iteration += 1

    def get_extra_state(self) -> dict[str, Any]:
        """What ``state_dict`` holds: the iteration and the state of the module's own generator."""
        return {"iteration": self.iteration, "generator": self._generator.get_state()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore what ``get_extra_state`` gave."""
        self.iteration = int(state["iteration"])
        self._generator.set_state(state["generator"])

    def _leaf(self, spec: TensorSpec) -> TensorSpec:
        return spec[self.action_key] if isinstance(spec, Composite) else spec

    def _noise(self, tensordict: TensorDictBase, like: Tensor) -> Tensor:
        """The noise [*batch], or [*batch, noise_size], of frames with ``like`` [*batch, n]."""
        shape = like.shape[:-1]
        if self.noise_size > 1:
            shape = (*shape, self.noise_size)
        noise = tensordict.get("noise", None)
        if noise is None:
            noise = torch.rand(shape, generator=self._generator, dtype=torch.float64)
        return noise.to(like.device).reshape(shape)


def exploring() -> bool:
    """Whether TorchRL's exploration type asks for exploration: RANDOM, or none set."""
    return exploration_type() in (ExplorationType.RANDOM, None)


def check_trials(trials: int, *values: float | NDArray[np.float64] | Tensor) -> None:
    """Refuse parameters with a value per trial, but not for all.

    Raises:
        ValueError: if there is one.
    """
    for value in values:
        if isinstance(value, np.ndarray) and value.shape != (trials,):
            raise ValueError(f"a parameter has {value.size} values, but there are {trials} trials")


def rows(
    value: float | NDArray[np.float64] | Tensor, trial: Tensor | None, like: Tensor
) -> float | Tensor:
    """One number, or the trials' own numbers as a column [*batch, 1], of the dtype of ``like``.

    Raises:
        ValueError: if the numbers differ between trials, and those of the frames are not known.
    """
    if not isinstance(value, np.ndarray):
        return value
    if trial is None:
        raise ValueError("the parameters differ between trials: the data need a 'trial' entry")
    return torch.as_tensor(value, dtype=like.dtype, device=like.device)[trial].unsqueeze(-1)
