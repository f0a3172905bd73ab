"""The base classes of strategies, and sampling by inverse CDF."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch._C._functorch import is_batchedtensor
from torchrl.data import (
    Categorical,
    Composite,
    MultiCategorical,
    MultiOneHot,
    OneHot,
    TensorSpec,
)
from torchrl.envs.utils import ExplorationType, exploration_type

from trl_explore.checks import check_integer, settle
from trl_explore.strategies import workers
from trl_explore.strategies.schedules import Constant, Rows, Schedule, Value, as_schedule


class BaseStrategy(TensorDictModuleBase):
    """A behaviour policy μ(·|s) made from the output of a target policy.

    The base class of ``Strategy`` (n actions) and ``ContinuousStrategy`` (vectors). It holds the
    hooks that a collector calls, the random numbers and the state, but no distribution.

    State that a trainer changes is in buffers, so that it reaches copies in other processes and on
    other devices: ``iteration``, ``frames``, and the current value of every schedule under the name
    of its parameter (``epsilon``, ``temperature``, ...).

    Random numbers come from torch's generator of the process, as in TorchRL's own modules, unless
    there is an entry ``noise_key``. Worker processes have different, reproducible numbers: see
    ``strategies.workers``.

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
        log_prob_key: the entry to write the log-probability to; None: beside the action, with the
            suffix "_log_prob".
        noise_key: the entry with uniform numbers in [0, 1) that decide the draw; None: there is
            none, except from a collector of this package, which writes "noise".
        trial_key: the entry with the trial of each frame; read only if a parameter or the state
            differs between trials.
    """

    actions: ClassVar[str]
    exact = True
    differentiable = False
    noise_size = 1
    learns_from_data: ClassVar[bool] = False
    per_episode: ClassVar[bool] = False
    iteration: Tensor
    frames: Tensor

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        settle(cls, "learns_from_data", True, ["step"])
        settle(cls, "per_episode", True, ["begin"])

    def __init__(
        self,
        in_keys: Sequence[NestedKey],
        *,
        action_key: NestedKey,
        log_prob_key: NestedKey | None,
        noise_key: NestedKey | None,
        trial_key: NestedKey,
    ) -> None:
        super().__init__()
        workers.watch(self)
        self.action_key, self.noise_key, self.trial_key = action_key, noise_key, trial_key
        name = action_key if isinstance(action_key, str) else action_key[-1]
        self.log_prob_key = log_prob_key or self._beside(f"{name}_log_prob")
        self.in_keys = list(in_keys)  # pyright: ignore[reportAttributeAccessIssue]
        written = [action_key, self.log_prob_key] if self.exact else [action_key]
        self.out_keys = written  # pyright: ignore[reportAttributeAccessIssue]
        self.register_buffer("iteration", torch.zeros((), dtype=torch.int64))
        self.register_buffer("frames", torch.zeros((), dtype=torch.int64))
        self.schedules: dict[str, Schedule] = {}
        self._reads_trial = False
        self._trained_here = False

    def __getstate__(self) -> dict[str, Any]:
        return workers.pack(self.__dict__.copy())

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(workers.unpack(state))
        workers.watch(self)

    def _beside(self, name: str) -> NestedKey:
        """The entry with this name in the group of the action."""
        return name if isinstance(self.action_key, str) else (*self.action_key[:-1], name)

    def follow(
        self,
        name: str,
        value: float | Sequence[float] | Schedule,
        low: float,
        high: float,
        *,
        low_open: bool = False,
    ) -> None:
        """Make a parameter follow a schedule: ``self.NAME`` is its value in the present iteration.

        Args:
            name: the name of the buffer: [], or [trials] if it differs between trials; float64.
            value: a number, one number per trial, or a schedule.
            low: the smallest value that is allowed.
            high: the largest value that is allowed.
            low_open: whether ``low`` itself is not allowed.

        Raises:
            ValueError: if the parameter leaves the bounds.
        """
        self.schedules[name] = as_schedule(name, value, low, high, low_open=low_open)
        self._place(name)

    def _place(self, name: str) -> None:
        """Allocate the buffer of a parameter."""
        value = torch.tensor(self._value(name), dtype=torch.float64, device=self.iteration.device)
        self.register_buffer(name, value)
        self._reads_trial |= value.ndim > 0

    def _value(self, name: str) -> Value:
        """The present value of a schedule."""
        schedule = self.schedules[name]
        clock = self.frames if schedule.clock == "frames" else self.iteration
        if clock.ndim:
            return np.array([schedule(time) for time in clock.tolist()])
        return schedule(int(clock))

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
            seed: seed of the job, given by a collector of this package, which also writes "noise";
                None: random numbers come from torch's generator.
            first_trial: trial index of row 0.

        Raises:
            ValueError: if a per-trial parameter does not have one value for every trial.
        """
        self._per_trial(trials)
        self._trained_here = seed is not None
        if seed is not None and self.noise_key is None:
            self.noise_key = "noise"
        self._reads_trial |= trials > 1
        timed = [name for name, schedule in self.schedules.items() if schedule.clock == "frames"]
        if trials > 1 and timed:  # episodes differ in length
            self.frames = torch.zeros(trials, dtype=torch.int64, device=self.frames.device)
            for name in timed:
                self._place(name)

    def on_policy(self) -> bool | NDArray[np.bool_]:
        """Whether μ = π by construction in the current iteration; one value, or one per trial.

        Importance weights are then exactly 1, not 1 up to rounding.
        """
        return False

    def is_target(self) -> bool:
        """Whether μ = π by construction for every trial in every iteration."""
        fixed = all(type(schedule) is Constant for schedule in self.schedules.values())
        return fixed and self.on_policy() is True

    def take(self, rows: slice, trials: int) -> None:
        """Keep only some of the trials: cut every per-trial parameter to their rows.

        Args:
            rows: the trials to keep.
            trials: the number of trials before the cut.

        Raises:
            ValueError: if a per-trial parameter does not have one value for every trial.
        """
        for name in self._per_trial(trials):
            self.schedules[name] = Rows(self.schedules[name], rows)
            self._place(name)

    def _per_trial(self, trials: int) -> list[str]:
        """The parameters with one value per trial.

        Raises:
            ValueError: if one does not have one value for every trial.
        """
        found = [name for name in self.schedules if getattr(self, name).ndim]
        for name in found:
            if len(getattr(self, name)) != trials:
                raise ValueError(
                    f"{name} has {len(getattr(self, name))} values, but there are {trials} trials"
                )
        return found

    def begin(self, active: NDArray[np.bool_], episodes: NDArray[np.int64]) -> None:
        """Prepare for the next episode of the active trials.

        Args:
            active: [trials] bool.
            episodes: [trials], the index of every trial's next episode, from 0.
        """

    def step(self, frames: TensorDictBase | int | None = None) -> None:
        """Advance by one iteration; called once per update.

        ``step(data)`` and ``step(n)`` also advance the number of frames. TorchRL's trainers call
        ``step(n)``, which is an error if a schedule counts iterations, because n is not their
        number.

        Args:
            frames: the frames of the iteration, needed if ``learns_from_data``, or their number.
                None is one frame.

        Raises:
            ValueError: if more than one frame is given as a number, and a schedule counts
                iterations.
        """
        number = self._number(frames)
        self.iteration += 1
        self.frames += number
        self._refresh()

    def keep_pace(self, other: BaseStrategy) -> None:
        """Go to the iteration and number of frames of another strategy."""
        self.iteration.copy_(other.iteration)
        self.frames = other.frames.clone()
        self._refresh()

    def _refresh(self) -> None:
        """Give every parameter the present value of its schedule."""
        for name, schedule in self.schedules.items():
            if type(schedule) is not Constant:
                buffer = getattr(self, name)
                value = torch.as_tensor(self._value(name), dtype=torch.float64)
                if value.shape == buffer.shape:
                    buffer.copy_(value)  # in place: shared memory and compiled code see it
                else:
                    self._place(name)

    def _number(self, frames: TensorDictBase | int | None) -> int | Tensor:
        """The number of frames; [trials] if trials are counted separately."""
        if frames is None:
            return 1
        if isinstance(frames, TensorDictBase):
            valid = padding_mask(frames)
            if self.frames.ndim:
                trial = frames.get(self.trial_key)[valid]
                return torch.bincount(trial, minlength=len(self.frames)).to(self.frames.device)
            return int(valid.sum())
        number = check_integer("the number of frames", frames, 0)
        for name, schedule in self.schedules.items():
            if number > 1 and schedule.clock != "frames" and type(schedule) is not Constant:
                raise ValueError(
                    f"step({number}) is {number} frames, but the schedule of {name} counts "
                    "iterations: give the schedule frames=..., or call step() once per update"
                )
        return number

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
        """Uniform numbers in [0, 1) [*batch] or [*batch, noise_size], float64 if drawn here."""
        shape = batch if self.noise_size == 1 else (*batch, self.noise_size)
        if self.noise_key is not None:
            noise = tensordict.get(self.noise_key, None)
            if noise is not None:
                return noise.to(device).reshape(shape)
        return torch.rand(shape, dtype=torch.float64, device=device)

    def _trial(self, tensordict: TensorDictBase) -> Tensor | None:
        """The trial of each frame, if something differs between trials."""
        return tensordict.get(self.trial_key, None) if self._reads_trial else None


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


def padding_mask(data: TensorDictBase) -> Tensor:
    """Whether a frame is one of the data, not padding of TorchRL's ``split_trajs`` [*batch]."""
    mask = data.get(("collector", "mask"), None)
    if mask is None:
        return torch.ones(data.batch_size, dtype=torch.bool, device=data.device)
    return mask.reshape(data.batch_size)


def exploring() -> bool:
    """Whether TorchRL's exploration type is RANDOM or unset."""
    return exploration_type() in (ExplorationType.RANDOM, None)


def rows(value: Value | Tensor, trial: Tensor | None, like: Tensor) -> float | Tensor:
    """A number as it is, or per-trial values as a column [*batch, 1] in the dtype of ``like``.

    Raises:
        ValueError: if the value is per trial and ``trial`` is None.
    """
    if getattr(value, "ndim", 0) == 0:
        return cast("float | Tensor", value)
    if trial is None:
        raise ValueError("missing key: 'trial' (a parameter has one value per trial)")
    column = torch.as_tensor(value, dtype=like.dtype, device=like.device)[trial]
    return column.reshape(column.shape + (1,) * (like.ndim - column.ndim))


def numbers(values: Iterable[Value | Tensor]) -> list[Value]:
    """The same values as numbers and arrays instead of tensors."""
    return [
        value if not isinstance(value, Tensor)
        else value.numpy(force=True) if value.ndim else value.item()
        for value in values
    ]  # fmt: skip


def present(weight: Value | Tensor) -> bool:
    """Whether a part of a mixture can have a weight: False only for the Python number 0."""
    return not isinstance(weight, int | float) or weight != 0


class Strategy(BaseStrategy):
    """A behaviour distribution μ(·|s) over n actions, made from the logits of a target policy.

    A subclass defines ``probs(logits)``. The action is drawn by inverse CDF from one uniform number
    u in [0, 1) per frame:

        a = min{k : Σ_{j ≤ k} μ(j|s) > u}

    The strategy explores if TorchRL's exploration type is RANDOM or unset. Under MODE, MEAN or
    DETERMINISTIC it takes the first action of largest logit, with log-probability 0.

    Reads "logits" [*batch, n_actions] and, if present, "action_mask" [*batch, n_actions] (bool
    or 0 and 1; False: μ forbids the action). A mask in the spec (``spec.update_mask``, TorchRL's
    ``ActionMask``) is obeyed too.
    Writes "action" ([*batch] int64, or one-hot [*batch, n_actions] under a ``OneHot`` spec) and
    "action_log_prob" [*batch] (nats, under μ; float32 for logits of lower precision).

    Under ``MultiOneHot`` and ``MultiCategorical`` the logits of the heads are joined,
    [*batch, Σ n_h]. Every head draws its own action, and the log-probabilities are added.

    The module works in any TorchRL project, after any module that writes logits or action values
    (``logits_key="action_value"``). A collector of this package also calls ``bind`` once, ``begin``
    before every episode and ``step`` after every update.

    Args:
        spec: the action spec (``Categorical``, ``OneHot``, ``MultiCategorical`` or ``MultiOneHot``,
            possibly in a ``Composite``); None: actions are indices.
        logits_key: the entry with the preferences.
        action_key: the entry to write the action to.
        action_mask_key: the entry with the mask; None: "action_mask" in the group of the action.
        log_prob_key: the entry to write the log-probability to; None: beside the action, with the
            suffix "_log_prob".
        noise_key: the entry with uniform numbers in [0, 1) that decide the draw ([*batch], or
            [*batch, heads]); None: there is none, except from a collector of this package.
        trial_key: the entry with the trial of each frame [*batch]; read only if a parameter or the
            state differs between trials.
        validate_args: whether to check that every state has an allowed action with a finite logit.
            In compiled code and on a GPU the check is ``torch._assert_async``.

    Raises:
        ValueError: if the spec is of another kind, or a state has no action to draw.
    """

    actions = "discrete"
    _index: Tensor

    def __init__(
        self,
        *,
        spec: TensorSpec | None = None,
        logits_key: NestedKey = "logits",
        action_key: NestedKey = "action",
        action_mask_key: NestedKey | None = None,
        log_prob_key: NestedKey | None = None,
        noise_key: NestedKey | None = None,
        trial_key: NestedKey = "trial",
        validate_args: bool = True,
    ) -> None:
        super().__init__(
            [logits_key],
            action_key=action_key,
            log_prob_key=log_prob_key,
            noise_key=noise_key,
            trial_key=trial_key,
        )
        self.logits_key, self.validate_args = logits_key, validate_args
        self.action_mask_key = action_mask_key or self._beside("action_mask")
        self.spec = None if spec is None else self._leaf(spec)
        self._heads = _heads(self.spec)
        if len(self._heads) > 1:
            width, total = max(self._heads), sum(self._heads)
            index = torch.full((len(self._heads), width), total)
            for head, part in zip(index, torch.arange(total).split(self._heads), strict=True):
                head[: len(part)] = part
            self.register_buffer("_index", index, persistent=False)

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
        logits = self._masked(tensordict, read(tensordict, self.logits_key))
        n_actions = logits.shape[-1]
        if exploring():
            batch = logits.shape[:-1]
            if len(self._heads) > 1:
                batch = torch.Size((*batch, len(self._heads)))
            noise = self._noise(tensordict, batch, logits.device)
            action, log_prob = self.explore(tensordict, logits, noise)
        else:
            logits = self._split(logits)
            action = logits.argmax(-1)
            largest = logits.gather(-1, action.unsqueeze(-1)).squeeze(-1)
            self._check(largest, -torch.inf, logits, tensordict)
            log_prob = torch.zeros_like(largest)
        tensordict.set(self.action_key, self._encode(action, n_actions))
        if log_prob is not None and self.exact:
            if len(self._heads) > 1:
                log_prob = log_prob.sum(-1)
            tensordict.set(self.log_prob_key, log_prob)
        return tensordict

    def _masked(self, tensordict: TensorDictBase, logits: Tensor) -> Tensor:
        """The logits in float32 or float64, −∞ where a mask forbids the action.

        Raises:
            ValueError: if the logits do not fit the spec, or a mask does not fit the logits.
        """
        if self._heads and logits.shape[-1] != sum(self._heads):
            raise ValueError(
                f"{self.logits_key!r} has {logits.shape[-1]} entries per frame, "
                f"but the action spec has {sum(self._heads)} actions"
            )
        if logits.dtype in (torch.float16, torch.bfloat16):  # too coarse for probabilities
            logits = logits.float()
        mask = tensordict.get(self.action_mask_key, None)
        if mask is not None:
            if mask.shape != logits.shape:
                raise ValueError(
                    f"{self.action_mask_key!r} is {list(mask.shape)}, but the logits are "
                    f"{list(logits.shape)}"
                )
            logits = torch.where(mask.bool(), logits, -torch.inf)
        mask = getattr(self.spec, "mask", None)
        if mask is not None:
            logits = torch.where(mask.to(logits.device).expand(logits.shape), logits, -torch.inf)
        return logits

    def _split(self, logits: Tensor) -> Tensor:
        """The logits of the heads [*batch, heads, n], padded with −∞; of one head as they are."""
        if len(self._heads) < 2:
            return logits
        return torch.nn.functional.pad(logits, (0, 1), value=-torch.inf)[..., self._index]

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
        logits = self._split(self.preferences(tensordict, logits))
        probs = self.probs(logits, self._trial(tensordict))
        action = self._draw(probs, noise, logits, tensordict)
        return action.squeeze(-1), probs.gather(-1, action).squeeze(-1).log()

    def _draw(
        self, probs: Tensor, noise: Tensor, logits: Tensor, tensordict: TensorDictBase
    ) -> Tensor:
        """The action [*batch, 1] by inverse CDF, checked."""
        cdf = probs.cumsum(-1, dtype=torch.float64)
        total = cdf[..., -1:]
        self._check(total, 0.0, logits, tensordict)
        return _search(cdf, total, noise.unsqueeze(-1))

    def _check(self, found: Tensor, low: float, logits: Tensor, tensordict: TensorDictBase) -> None:
        """Check that every state has an action to draw: ``found`` is above ``low``, not NaN.

        Raises:
            ValueError: if one has none, and not because the policy's output is NaN.
        """
        if not self.validate_args or not found.numel():
            return
        if torch.compiler.is_compiling() or not found.is_cpu:
            message = "a state has no allowed action with a finite logit"
            cast(Any, torch)._assert_async((found > low).all(), message)
        elif not is_batchedtensor(found) and not found.min().item() > low:
            bad = ~(found.reshape(logits.shape[:-1]) > low) & ~logits.isnan().any(-1)
            mask = tensordict.get(self.action_mask_key, None)
            if mask is not None and not mask.bool().any(-1).all():
                raise ValueError("the action mask forbids every action of a state")
            # Our trainer stops a trial that diverges, and goes on with the others.
            if bad.any() and not self._trained_here:
                raise ValueError(
                    f"a state has no allowed action with a finite logit: in {self.logits_key!r} "
                    "every action that the mask allows has -inf, or one has inf"
                )

    def _encode(self, action: Tensor, n_actions: int) -> Tensor:
        """The action in the form of the spec."""
        if self.spec is None:
            return action
        if isinstance(self.spec, OneHot):
            if len(self._heads) > 1:
                hot = action.unsqueeze(-1) == torch.arange(max(self._heads), device=action.device)
                action = hot.flatten(-2)[..., self._index.flatten() < n_actions]
            else:
                action = action.unsqueeze(-1) == torch.arange(n_actions, device=action.device)
        return action.to(self.spec.dtype)


def _heads(spec: TensorSpec | None) -> list[int]:
    """The number of actions of each head of a spec; [] without a spec.

    Raises:
        ValueError: if the spec is of another kind.
    """
    if spec is None:
        return []
    if type(spec) in (Categorical, OneHot):
        return [int(cast(Any, spec.space).n)]
    if isinstance(spec, MultiOneHot):
        return [int(box.n) for box in cast(Any, spec.space)]
    if isinstance(spec, MultiCategorical):
        sizes = spec.nvec.reshape(-1, spec.nvec.shape[-1])
        if bool((sizes == sizes[0]).all()):
            return sizes[0].tolist()
    raise ValueError(
        "the action spec must be Categorical, OneHot, MultiCategorical or MultiOneHot, "
        f"got {type(spec).__name__}"
    )


def inverse_cdf(probs: Tensor, noise: Tensor) -> Tensor:
    """The action a = min{k : Σ_{j ≤ k} p_j > u · Σ_j p_j} [*batch] for u = ``noise`` [*batch].

    Sums are in float64. Rounding never selects an action of probability 0: u is kept so far below 1
    that u times the computed sum is below the sum.

    Args:
        probs: [*batch, n_actions], non-negative.
        noise: [*batch], uniform in [0, 1).

    Example:
        >>> inverse_cdf(torch.tensor([0.25, 0.0, 0.75]), torch.tensor(0.25))
        tensor(2)
    """
    cdf = probs.cumsum(-1, dtype=torch.float64)
    return _search(cdf, cdf[..., -1:], noise.unsqueeze(-1)).squeeze(-1)


def _search(cdf: Tensor, total: Tensor, noise: Tensor) -> Tensor:
    """The first action whose cumulative sum is above the noise [*batch, 1]."""
    point = noise.double().clamp(max=1 - 2**-52) * total
    return (cdf <= point).sum(-1, keepdim=True)  # 0 where the sums are NaN
