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
from torchrl.data import Categorical, Composite, OneHot, TensorSpec
from torchrl.envs.utils import ExplorationType, exploration_type

from trl_explore.checks import settle
from trl_explore.strategies.schedules import Rows, Schedule


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
        learns_from_data: whether ``step`` learns from the frames of an iteration, and must get
            them. True in a class that overrides ``step``, unless the class says otherwise.
        per_episode: whether ``begin`` prepares every episode, so that ``preferences`` and ``probs``
            are those of the last episode of an iteration. True in a class that overrides ``begin``,
            unless the class says otherwise.

    Args:
        in_keys: the entries that it reads.
        action_key: the entry to write the action to.
        seed: seed of the module's own generator, used where no "noise" entry is given.
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
        """Learn which policy the strategy serves: called once, by the collector.

        Args:
            policy: the target policy.
            trials: the number of trials, rows of the policy's parameters.
            seed: seed of the job.
            first_trial: trial index of row 0.

        Raises:
            ValueError: if a parameter has one value per trial, but not for all.
        """

    def take(self, rows: slice, trials: int) -> None:
        """Serve only these of the trials: parameters with one value per trial are cut to them.

        Args:
            rows: which trials.
            trials: the number of all trials.

        Raises:
            ValueError: if a parameter has one value per trial, but not for all.
        """
        schedules = {k: value for k, value in vars(self).items() if isinstance(value, Schedule)}
        for name, schedule in schedules.items():
            value = schedule(self.iteration)
            if isinstance(value, np.ndarray):
                if len(value) != trials:
                    raise ValueError(
                        f"{name} has {len(value)} values, but there are {trials} trials"
                    )
                setattr(self, name, Rows(schedule, rows))

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


class Strategy(BaseStrategy):
    """A behaviour distribution μ(·|s) over n actions, made from the logits of a target policy.

    A subclass states ``probs(logits)``; everything else is here. The action is drawn by inverse
    CDF from one uniform number u in [0, 1) per frame:

        a = min{k : Σ_{j ≤ k} μ(j|s) > u}

    Under ``ExplorationType.RANDOM``, or none set, the strategy explores. Under MODE, MEAN or
    DETERMINISTIC it takes the first action of largest logit, with log-probability 0.

    Reads "logits" [*batch, n_actions]; if present "action_mask" [*batch, n_actions] (bool, False
    forbids: the mask applies to μ), "noise" [*batch] (the u above), and "trial" [*batch].
    Writes "action" ([*batch] int64, or one-hot [*batch, n_actions] under a ``OneHot`` spec) and
    "action_log_prob" [*batch] (nats, under μ).

    Nothing here knows of trials, CartPole or REINFORCE: after any TorchRL module that writes
    logits or action values, the module serves any TorchRL project (``logits_key="action_value"``).
    A collector of this package tells it more: ``bind`` once, ``begin`` before every episode,
    ``step`` after every update.

    Attributes:
        exact: whether "action_log_prob" is the exact log-probability of the action under μ; a
            strategy for which that does not exist writes none.
        differentiable: whether ``probs`` is differentiable in the logits, in every iteration.
        noise_size: how many uniform numbers it uses for each frame; where more than one, "noise"
            is [*batch, noise_size].

    Args:
        spec: the action spec (``Categorical`` or ``OneHot``, also in a ``Composite``); None means
            that actions are indices.
        logits_key: the entry with the preferences.
        action_key: the entry to write the action to.
        action_mask_key: the entry with the mask.
        seed: seed of the module's own generator, used where no "noise" entry is given.

    Raises:
        ValueError: if the spec is not of a kind served, or a mask forbids every action.
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
                f"a strategy serves Categorical and OneHot action specs, got {type(spec).__name__}"
            )
        self.spec = spec
        self.logits_key, self.action_mask_key = logits_key, action_mask_key

    @abstractmethod
    def probs(self, logits: Tensor, trial: Tensor | None = None) -> Tensor:
        """μ(·|s) [*batch, n_actions] in the current iteration; an action of logit −∞ gets 0.

        Args:
            logits: [*batch, n_actions].
            trial: [*batch] int64, needed only where parameters differ between trials.
        """
        raise NotImplementedError(f"{type(self).__name__} does not state its probs")

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Draw "action" from μ and write "action_log_prob"."""
        logits = tensordict.get(self.logits_key)
        mask = tensordict.get(self.action_mask_key, None)
        if mask is not None:
            if not mask.any(-1).all():
                raise ValueError("the action mask forbids every action of a state")
            logits = logits.masked_fill(~mask, -torch.inf)
        if exploring():
            action, log_prob = self.explore(tensordict, logits, self._noise(tensordict, logits))
        else:
            action = logits.argmax(-1)
            log_prob = torch.zeros_like(logits[..., 0])
        tensordict.set(self.action_key, self._encode(action, logits.shape[-1]))
        if self.exact:
            tensordict.set("action_log_prob", log_prob)
        return tensordict

    def preferences(self, tensordict: TensorDictBase, logits: Tensor) -> Tensor:
        """What ``probs`` is given to act on: here the logits of the target policy themselves.

        Args:
            tensordict: everything known of the frames.
            logits: [*batch, n_actions], masked: −∞ where an action is forbidden, and stays so.
        """
        return logits

    def explore(
        self, tensordict: TensorDictBase, logits: Tensor, noise: Tensor
    ) -> tuple[Tensor, Tensor | None]:
        """Draw from μ(·|s).

        Args:
            tensordict: everything known of the frames.
            logits: [*batch, n_actions], masked.
            noise: [*batch], or [*batch, noise_size].

        Returns:
            The action [*batch] and its log-probability [*batch]; None if it has no exact one.
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
    """The action a = min{k : Σ_{j ≤ k} p_j > u · Σ_j p_j} [*batch] of u = ``noise`` [*batch].

    Sums are in float64. Rounding never selects an action of probability 0: u is scaled by the
    sum as computed, and kept below it.

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
