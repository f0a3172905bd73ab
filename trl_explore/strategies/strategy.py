"""The base class of strategies: keys, random numbers, and the hooks of collectors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, TypedDict

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.envs.utils import ExplorationType, exploration_type

from trl_explore.checks import withdraw
from trl_explore.strategies import worker_seeds
from trl_explore.strategies.parameters import Parametrised
from trl_explore.strategies.schedules import Constant

BELOW_ONE = 1 - 2**-53
"""The largest number below 1, and the largest noise: its product with a sum is below the sum."""


class Keys(TypedDict, total=False):
    """The arguments of ``BaseStrategy``, which every strategy takes too."""

    action_key: NestedKey
    log_prob_key: NestedKey | None
    noise_key: NestedKey | None
    trial_key: NestedKey


class BaseStrategy(Parametrised):
    """A behaviour policy μ(·|s) made from the output of a target policy.

    The base class of ``Strategy`` (n actions) and ``ContinuousStrategy`` (vectors). It holds the
    hooks that a collector calls, the random numbers and the state, but no distribution.

    Random numbers come from torch's generator of the process, as in TorchRL's own modules, unless
    there is an entry ``noise_key``. Worker processes have different, reproducible numbers: see
    ``strategies.worker_seeds``.

    Attributes:
        actions: the kind of action, "discrete" or "continuous".
        exact: whether the log-probability of the action is known exactly. If False, the strategy
            writes none.
        differentiable: whether the probability under μ is differentiable in the policy's output,
            in every iteration.
        noise_size: the number of uniform numbers per draw; if more than one, the noise is
            [*batch, noise_size].
        learns_from_data: whether ``step`` needs the frames of the iteration. True in a class that
            overrides ``step``, unless the class declares it.
        per_episode: whether ``begin`` prepares every episode, so that ``preferences`` and ``probs``
            are those of the last episode of an iteration. True in a class that overrides ``begin``,
            unless the class declares it.

    Args:
        in_keys: the entries to read.
        action_key: the entry to write the action to.
        log_prob_key: the entry to write the log-probability to; None: next to the action, with the
            suffix "_log_prob".
        noise_key: the entry with uniform numbers in [0, 1) that decide the draw ([*batch], or
            [*batch, noise_size]); None: there is none, except from a collector of this package.
        trial_key: the entry with the trial of each frame [*batch]; read only if a parameter or the
            state differs between trials.
    """

    actions: ClassVar[str]
    exact = True
    differentiable = False
    noise_size = 1
    learns_from_data: ClassVar[bool] = False
    per_episode: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        withdraw(cls, "learns_from_data", True, ["step"])
        withdraw(cls, "per_episode", True, ["begin"])

    def __init__(
        self,
        in_keys: Sequence[NestedKey],
        *,
        action_key: NestedKey = "action",
        log_prob_key: NestedKey | None = None,
        noise_key: NestedKey | None = None,
        trial_key: NestedKey = "trial",
    ) -> None:
        super().__init__(trial_key)
        worker_seeds.watch(self)
        self.action_key, self.noise_key = action_key, noise_key
        name = action_key if isinstance(action_key, str) else action_key[-1]
        self.log_prob_key = log_prob_key or self._beside(f"{name}_log_prob")
        self.in_keys = list(in_keys)  # pyright: ignore[reportAttributeAccessIssue]
        written = [action_key, self.log_prob_key] if self.exact else [action_key]
        self.out_keys = written  # pyright: ignore[reportAttributeAccessIssue]
        self._seed = self._first_trial = 0
        self._trained_here = False

    def __getstate__(self) -> dict[str, Any]:
        return worker_seeds.pack(self.__dict__.copy())

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(worker_seeds.unpack(state))
        worker_seeds.watch(self)

    def _beside(self, name: str) -> NestedKey:
        """The entry with this name in the group of the action."""
        return name if isinstance(self.action_key, str) else (*self.action_key[:-1], name)

    def set_spec(self, spec: TensorSpec) -> None:
        """Check and store the environment's action spec; the collector calls this once.

        Raises:
            ValueError: if the strategy does not draw actions of this kind.
        """
        spec = self._leaf(spec)
        if spec.domain != self.actions:
            raise ValueError(
                f"{type(self).__name__} draws {self.actions} actions, "
                f"but the environment's actions are {spec.domain}"
            )

    def bind(
        self,
        policy: TensorDictModuleBase,
        trials: int,
        *,
        seed: int | None = None,
        first_trial: int = 0,
    ) -> None:
        """Connect the strategy to its target policy; the collector calls this once.

        Args:
            policy: the target policy.
            trials: the number of trials: the rows of the policy's parameters.
            seed: seed of the job, from a collector of this package, which also writes "noise".
            first_trial: trial index of row 0.

        Raises:
            ValueError: if a per-trial parameter does not have one value for every trial.
        """
        self.spread(trials)
        self._trained_here = seed is not None
        self._seed, self._first_trial = seed or 0, first_trial
        if seed is not None and self.noise_key is None:
            self.noise_key = "noise"
        self.allocate(policy, trials)

    def allocate(self, policy: TensorDictModuleBase, trials: int) -> None:
        """Check the parameters and reset the state for the trials of ``bind``."""

    def on_policy(self) -> bool | NDArray[np.bool_]:
        """Whether μ = π by construction in the current iteration; one value, or one per trial.

        Importance weights are then exactly 1, not 1 up to rounding.
        """
        return False

    def is_target(self) -> bool:
        """Whether μ = π by construction for every trial in every iteration."""
        fixed = all(type(schedule) is Constant for schedule in self.schedules.values())
        return fixed and self.on_policy() is True

    def begin(self, active: NDArray[np.bool_], episodes: NDArray[np.int64]) -> None:
        """Prepare for the next episode of the ``active`` trials, whose index is in ``episodes``."""

    def _leaf(self, spec: TensorSpec) -> TensorSpec:
        if not isinstance(spec, Composite):
            return spec
        leaves = list(spec.keys(include_nested=True, leaves_only=True))
        if self.action_key not in leaves:
            raise ValueError(
                f"the action spec has no entry {self.action_key!r}; action_key can be one of "
                f"{', '.join(map(repr, leaves))}"
            )
        return spec[self.action_key]

    def _noise(self, tensordict: TensorDictBase, batch: torch.Size, device: torch.device) -> Tensor:
        """Uniform numbers in [0, 1), float64 [*batch] or [*batch, noise_size]."""
        shape = batch if self.noise_size == 1 else (*batch, self.noise_size)
        if self.noise_key is not None:
            noise = tensordict.get(self.noise_key, None)
            if noise is not None:
                return noise.to(device, torch.float64).reshape(shape).clamp(max=BELOW_ONE)
        return torch.rand(shape, dtype=torch.float64, device=device)  # at most BELOW_ONE

    def _trial(self, tensordict: TensorDictBase) -> Tensor | None:
        """The trial of each frame, if something differs between trials."""
        return tensordict.get(self.trial_key, None) if self._reads_trial else None


def exploring() -> bool:
    """Whether TorchRL's exploration type is RANDOM or unset."""
    return exploration_type() in (ExplorationType.RANDOM, None)
