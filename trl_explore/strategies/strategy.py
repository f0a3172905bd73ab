"""The base classes of strategies, and sampling by inverse CDF."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Categorical, Composite, OneHot, TensorSpec
from torchrl.envs.utils import ExplorationType, exploration_type

from trl_explore.checks import settle
from trl_explore.strategies.schedules import Constant, Rows, Schedule


class BaseStrategy(TensorDictModuleBase):
    """A behaviour policy μ(·|s) made from the output of a target policy.

    The base class of ``Strategy`` (n actions) and ``ContinuousStrategy`` (vectors). It holds the
    hooks that a collector calls, the random numbers and the state, but no distribution.

    Attributes:
        actions: the kind of action, "discrete" or "continuous".
        exact: whether "action_log_prob" is the exact log-probability of the action under μ. If
            False, the strategy writes none.
        differentiable: whether the probability under μ is differentiable in the policy's output,
            in every iteration.
        noise_size: the number of uniform numbers per frame; if more than one, "noise" is
            [*batch, noise_size].
        learns_from_data: whether ``step`` needs the frames of the iteration. True in a class that
            overrides ``step``, unless the class declares it.
        per_episode: whether ``begin`` prepares every episode, so that ``preferences`` and ``probs``
            are those of the last episode of an iteration. True in a class that overrides ``begin``,
            unless the class declares it.

    Args:
        in_keys: the entries to read.
        action_key: the entry to write the action to.
        seed: seed of the module's own generator, used if there is no "noise" entry.
    """

    actions: ClassVar[str]
    exact = True
    differentiable = False
    noise_size = 1
    learns_from_data: ClassVar[bool] = False
    per_episode: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        settle(cls, "learns_from_data", True, ["step"])
        settle(cls, "per_episode", True, ["begin"])

    def __init__(self, in_keys: list[NestedKey], *, action_key: NestedKey, seed: int) -> None:
        super().__init__()
        self.action_key = action_key
        self.in_keys = in_keys  # pyright: ignore[reportAttributeAccessIssue]
        written = [action_key, "action_log_prob"] if self.exact else [action_key]
        self.out_keys = written  # pyright: ignore[reportAttributeAccessIssue]
        self.iteration = 0
        self._generator = torch.Generator().manual_seed(seed)

    def serve(self, spec: TensorSpec) -> None:
        """Check and store the environment's action spec; the collector calls this once.

        Args:
            spec: the action spec of the environment.

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
        self, policy: TensorDictModuleBase, trials: int, *, seed: int = 0, first_trial: int = 0
    ) -> None:
        """Connect the strategy to its target policy; the collector calls this once.

        Args:
            policy: the target policy.
            trials: the number of trials: the rows of the policy's parameters.
            seed: seed of the job.
            first_trial: trial index of row 0.

        Raises:
            ValueError: if a per-trial parameter does not have one value for every trial.
        """
        self._per_trial(trials)

    def on_policy(self) -> bool | NDArray[np.bool_]:
        """Whether μ = π by construction in the current iteration; one value, or one per trial.

        Importance weights are then exactly 1, not 1 up to rounding.
        """
        return False

    def is_target(self) -> bool:
        """Whether μ = π by construction for every trial in every iteration."""
        schedules = [value for value in vars(self).values() if isinstance(value, Schedule)]
        fixed = all(type(schedule) is Constant for schedule in schedules)
        return fixed and self.on_policy() is True

    def take(self, rows: slice, trials: int) -> None:
        """Keep only some of the trials: cut every per-trial parameter to their rows.

        Args:
            rows: the trials to keep.
            trials: the number of trials before the cut.

        Raises:
            ValueError: if a per-trial parameter does not have one value for every trial.
        """
        for name, schedule in self._per_trial(trials).items():
            setattr(self, name, Rows(schedule, rows))

    def _per_trial(self, trials: int) -> dict[str, Schedule]:
        """The parameters with one value per trial.

        Raises:
            ValueError: if one does not have one value for every trial.
        """
        found: dict[str, Schedule] = {}
        for name, schedule in vars(self).items():
            if not isinstance(schedule, Schedule):
                continue
            value = schedule(self.iteration)
            if isinstance(value, np.ndarray):
                if len(value) != trials:
                    raise ValueError(
                        f"{name} has {len(value)} values, but there are {trials} trials"
                    )
                found[name] = schedule
        return found

    def begin(self, active: NDArray[np.bool_], episodes: NDArray[np.int64]) -> None:
        """Prepare for the next episode of the active trials.

        Args:
            active: [trials] bool.
            episodes: [trials], the index of every trial's next episode, from 0.
        """

    def step(self, data: TensorDictBase | None = None) -> None:
        """Advance by one iteration; called once per update.

        Args:
            data: the frames of the iteration; needed if ``learns_from_data``.
        """
        self.iteration += 1

    def get_extra_state(self) -> dict[str, Any]:
        """The state for ``state_dict``: the iteration and the state of the module's generator."""
        return {"iteration": self.iteration, "generator": self._generator.get_state()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore the state from ``get_extra_state``."""
        self.iteration = int(state["iteration"])
        self._generator.set_state(state["generator"])

    def _leaf(self, spec: TensorSpec) -> TensorSpec:
        return spec[self.action_key] if isinstance(spec, Composite) else spec

    def _noise(self, tensordict: TensorDictBase, like: Tensor) -> Tensor:
        """The noise [*batch] or [*batch, noise_size] for frames shaped as ``like`` [*batch, n]."""
        shape = like.shape[:-1]
        if self.noise_size > 1:
            shape = (*shape, self.noise_size)
        noise = tensordict.get("noise", None)
        if noise is None:
            noise = torch.rand(shape, generator=self._generator, dtype=torch.float64)
        return noise.to(like.device).reshape(shape)


def read(tensordict: TensorDictBase, key: NestedKey) -> Tensor:
    """The entry under ``key``.

    Raises:
        KeyError: if it is missing; the message names the entries that are there.
    """
    value = tensordict.get(key, None)
    if value is None:
        there = ", ".join(map(str, tensordict.keys(include_nested=True, leaves_only=True)))
        raise KeyError(f"missing key: {key!r}; the data have {there or 'no entries'}")
    return value


def exploring() -> bool:
    """Whether TorchRL's exploration type is RANDOM or unset."""
    return exploration_type() in (ExplorationType.RANDOM, None)


def rows(
    value: float | NDArray[np.float64] | Tensor, trial: Tensor | None, like: Tensor
) -> float | Tensor:
    """A number as it is, or per-trial values as a column [*batch, 1] in the dtype of ``like``.

    Raises:
        ValueError: if the value is per trial and ``trial`` is None.
    """
    if not isinstance(value, np.ndarray):
        return value
    if trial is None:
        raise ValueError("missing key: 'trial' (a parameter has one value per trial)")
    return torch.as_tensor(value, dtype=like.dtype, device=like.device)[trial].unsqueeze(-1)


class Strategy(BaseStrategy):
    """A behaviour distribution μ(·|s) over n actions, made from the logits of a target policy.

    A subclass defines ``probs(logits)``. The action is drawn by inverse CDF from one uniform number
    u in [0, 1) per frame:

        a = min{k : Σ_{j ≤ k} μ(j|s) > u}

    The strategy explores if TorchRL's exploration type is RANDOM or unset. Under MODE, MEAN or
    DETERMINISTIC it takes the first action of largest logit, with log-probability 0.

    Reads "logits" [*batch, n_actions] and, if present, "action_mask" [*batch, n_actions] (bool
    or 0 and 1; False: μ forbids the action), "noise" [*batch] (the u above) and "trial" [*batch].
    Writes "action" ([*batch] int64, or one-hot [*batch, n_actions] under a ``OneHot`` spec) and
    "action_log_prob" [*batch] (nats, under μ).

    The module works in any TorchRL project, after any module that writes logits or action values
    (``logits_key="action_value"``). A collector of this package also calls ``bind`` once, ``begin``
    before every episode and ``step`` after every update.

    Attributes:
        exact: whether "action_log_prob" is the exact log-probability of the action under μ. If
            False, the strategy writes none.
        differentiable: whether ``probs`` is differentiable in the logits, in every iteration.
        noise_size: the number of uniform numbers per frame; if more than one, "noise" is
            [*batch, noise_size].

    Args:
        spec: the action spec (``Categorical`` or ``OneHot``, possibly in a ``Composite``); None:
            actions are indices.
        logits_key: the entry with the preferences.
        action_key: the entry to write the action to.
        action_mask_key: the entry with the mask.
        seed: seed of the module's own generator, used if there is no "noise" entry.

    Raises:
        ValueError: if the spec is of another kind, or a mask forbids every action of a state.
    """

    actions = "discrete"

    def __init__(
        self,
        *,
        spec: TensorSpec | None = None,
        logits_key: NestedKey = "logits",
        action_key: NestedKey = "action",
        action_mask_key: NestedKey = "action_mask",
        seed: int = 0,
    ) -> None:
        super().__init__([logits_key], action_key=action_key, seed=seed)
        spec = None if spec is None else self._leaf(spec)
        if spec is not None and type(spec) not in (Categorical, OneHot):
            raise ValueError(
                f"the action spec must be Categorical or OneHot, got {type(spec).__name__}"
            )
        self.spec = spec
        self._n_actions = None if spec is None else int(cast(Any, spec.space).n)
        self.logits_key, self.action_mask_key = logits_key, action_mask_key

    @abstractmethod
    def probs(self, logits: Tensor, trial: Tensor | None = None) -> Tensor:
        """μ(·|s) [*batch, n_actions] in the current iteration; 0 for an action of logit −∞.

        Args:
            logits: [*batch, n_actions].
            trial: [*batch] int64, needed only if parameters differ between trials.
        """
        raise NotImplementedError(f"{type(self).__name__} does not define probs")

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Draw "action" from μ and write "action_log_prob"."""
        logits = read(tensordict, self.logits_key)
        if self._n_actions not in (None, logits.shape[-1]):
            raise ValueError(
                f"{self.logits_key!r} has {logits.shape[-1]} entries per frame, "
                f"but the action spec has {self._n_actions} actions"
            )
        mask = tensordict.get(self.action_mask_key, None)
        if mask is not None:
            logits = logits.masked_fill(~self._legal(mask, logits), -torch.inf)
        if exploring():
            action, log_prob = self.explore(tensordict, logits, self._noise(tensordict, logits))
        else:
            action = logits.argmax(-1)
            log_prob = torch.zeros_like(logits[..., 0])
        tensordict.set(self.action_key, self._encode(action, logits.shape[-1]))
        if self.exact:
            tensordict.set("action_log_prob", log_prob)
        return tensordict

    def _legal(self, mask: Tensor, logits: Tensor) -> Tensor:
        """The action mask [*batch, n_actions] as bool.

        Raises:
            ValueError: if its shape is not that of the logits, or a state has no legal action.
        """
        if mask.shape != logits.shape:
            raise ValueError(
                f"{self.action_mask_key!r} is {list(mask.shape)}, but the logits are "
                f"{list(logits.shape)}"
            )
        mask = mask.bool()  # environments also give int8 or uint8
        if not mask.any(-1).all():
            raise ValueError("the action mask forbids every action of a state")
        return mask

    def preferences(self, tensordict: TensorDictBase, logits: Tensor) -> Tensor:
        """The input of ``probs``: by default, the logits of the target policy.

        Args:
            tensordict: the frames.
            logits: [*batch, n_actions], masked: −∞ where an action is forbidden; keep it there.
        """
        return logits

    def explore(
        self, tensordict: TensorDictBase, logits: Tensor, noise: Tensor
    ) -> tuple[Tensor, Tensor | None]:
        """Draw from μ(·|s).

        Args:
            tensordict: the frames.
            logits: [*batch, n_actions], masked.
            noise: [*batch], or [*batch, noise_size].

        Returns:
            The action [*batch] and its log-probability [*batch], None if there is no exact one.
        """
        logits = self.preferences(tensordict, logits)
        probs = self.probs(logits, tensordict.get("trial", None))
        action = inverse_cdf(probs, noise)
        return action, probs.gather(-1, action.unsqueeze(-1)).squeeze(-1).log()

    def _encode(self, action: Tensor, n_actions: int) -> Tensor:
        if self.spec is None:
            return action
        if isinstance(self.spec, OneHot):
            action = torch.nn.functional.one_hot(action, n_actions)
        return action.to(self.spec.dtype)


def inverse_cdf(probs: Tensor, noise: Tensor) -> Tensor:
    """The action a = min{k : Σ_{j ≤ k} p_j > u · Σ_j p_j} [*batch] for u = ``noise`` [*batch].

    Sums are in float64. Rounding never selects an action of probability 0: u is scaled by the
    computed sum and kept below it.

    Args:
        probs: [*batch, n_actions], non-negative.
        noise: [*batch], uniform in [0, 1).

    Example:
        >>> inverse_cdf(torch.tensor([0.25, 0.0, 0.75]), torch.tensor(0.25))
        tensor(2)
    """
    cdf = probs.double().cumsum(-1)
    total = cdf[..., -1]
    point = torch.minimum(noise * total, torch.nextafter(total, torch.zeros_like(total)))
    return (cdf[..., :-1] <= point.unsqueeze(-1)).sum(-1)
