"""Parameters that follow schedules, and the clocks that move them."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from trl_explore.checks import check_integer
from trl_explore.strategies.frames import PADDING, padding_mask, readable
from trl_explore.strategies.schedules import (
    Constant,
    Parameter,
    Rows,
    Schedule,
    Value,
    as_schedule,
)


class Parametrised(TensorDictModuleBase):
    """A module whose parameters (ε, a temperature, ...) follow schedules.

    What changes is in buffers, so that it reaches copies in other processes and on other devices:
    ``iteration``, ``frames``, and the present value of every schedule under the name of its
    parameter.

    Args:
        trial_key: the entry with the trial of each frame.

    Raises:
        ValueError: under ``torch.device("meta")``.
    """

    iteration: Tensor
    frames: Tensor

    def __init__(self, trial_key: NestedKey) -> None:
        super().__init__()
        self.trial_key = trial_key
        self.register_buffer("iteration", torch.zeros((), dtype=torch.int64))
        self.register_buffer("frames", torch.zeros((), dtype=torch.int64))
        if self.iteration.is_meta:
            raise ValueError(
                f'{type(self).__name__} holds values, which a device "meta" cannot keep: '
                'build it outside torch.device("meta")'
            )
        self.schedules: dict[str, Schedule] = {}
        self._reads_trial = False

    def follow(
        self,
        name: str,
        value: Parameter,
        low: float = 0.0,
        high: float = float("inf"),
        *,
        low_open: bool = False,
    ) -> None:
        """Make a parameter follow a schedule: ``self.NAME`` is its value in the present iteration.

        The buffer is float64, [], or [trials] if the parameter differs between trials. It must stay
        in [low, high], or in (low, high] with ``low_open``.

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

    def now(self, name: str) -> float | Tensor:
        """The present value of a parameter: a Python number, if it is one number and readable.

        Arithmetic with Python numbers takes a fraction of the time of that with the buffer.
        """
        buffer = self._buffers[name]
        assert buffer is not None
        return buffer if buffer.ndim or not readable(buffer) else buffer.item()

    def _value(self, name: str) -> Value:
        """The present value of a schedule."""
        schedule = self.schedules[name]
        clock = self.frames if schedule.clock == "frames" else self.iteration
        if clock.ndim:
            return np.array([schedule(time) for time in clock.tolist()])
        return schedule(int(clock))

    def spread(self, trials: int) -> None:
        """Count the frames of each of ``trials`` trials, as episodes differ in length.

        Raises:
            ValueError: if a per-trial parameter does not have one value for every trial.
        """
        self._per_trial(trials)
        self._reads_trial |= trials > 1
        timed = [name for name, schedule in self.schedules.items() if schedule.clock == "frames"]
        if trials > 1 and timed:
            self.frames = torch.zeros(trials, dtype=torch.int64, device=self.frames.device)
            for name in timed:
                self._place(name)

    def take(self, rows: slice, trials: int) -> None:
        """Keep only some of the ``trials`` trials: cut every per-trial parameter to their rows."""
        for name in self._per_trial(trials):
            self.schedules[name] = Rows(self.schedules[name], rows)
            self._place(name)

    def _per_trial(self, trials: int) -> list[str]:
        """The parameters with one value per trial, which must be ``trials`` values."""
        found = [name for name in self.schedules if getattr(self, name).ndim]
        for name in found:
            if len(getattr(self, name)) != trials:
                raise ValueError(
                    f"{name} has {len(getattr(self, name))} values, but there are {trials} trials"
                )
        return found

    def step(self, frames: TensorDictBase | int | None = None) -> None:
        """Advance by one iteration; called once per update.

        ``step(data)`` and ``step(n)``, as TorchRL's trainers call it, also advance the number of
        frames.

        Args:
            frames: the frames of the iteration, needed if ``learns_from_data``, or their number.
                None is one frame.

        Raises:
            ValueError: if more than one frame is given as a number, and a schedule counts
                iterations.
        """
        number = self._number(frames)
        self.iteration.data.add_(1)  # data: also if built in ``torch.inference_mode``
        self.frames.data.add_(number)
        self._refresh()

    def keep_pace(self, other: Parametrised) -> None:
        """Go to the iteration and number of frames of another module."""
        self.iteration.data.copy_(other.iteration)
        self.frames = other.frames.clone()
        self._refresh()

    def _refresh(self) -> None:
        """Give every parameter the present value of its schedule."""
        for name, schedule in self.schedules.items():
            if type(schedule) is not Constant:
                buffer, value = getattr(self, name), self._value(name)
                # In place, because shared memory and compiled code see the buffer.
                if buffer.ndim == 0 and isinstance(value, float):
                    buffer.data.fill_(value)
                elif np.shape(value) == buffer.shape:
                    buffer.data.copy_(torch.as_tensor(value, dtype=torch.float64))
                else:
                    self._place(name)

    def _number(self, frames: TensorDictBase | int | None) -> int | Tensor:
        """The number of frames; [trials] if trials are counted separately."""
        if frames is None:
            return 1
        if isinstance(frames, TensorDictBase):
            if self.frames.ndim:
                trial = frames.get(self.trial_key)[padding_mask(frames)]
                return torch.bincount(trial, minlength=len(self.frames)).to(self.frames.device)
            mask = frames.get(PADDING, None)
            return frames.batch_size.numel() if mask is None else int(mask.sum())
        number = check_integer("the number of frames", frames, 0)
        for name, schedule in self.schedules.items():
            if number > 1 and schedule.clock != "frames" and type(schedule) is not Constant:
                raise ValueError(
                    f"step({number}) is {number} frames, but the schedule of {name} counts "
                    "iterations: give the schedule frames=..., or call step() once per update"
                )
        return number


def advance(module: Parametrised, frames: int) -> None:
    """``module.step`` of an iteration of which only the number of frames is known.

    It does not call a ``step`` that a subclass overrides.
    """
    for buffer, number in ((module.iteration, 1), (module.frames, frames)):
        if buffer.dtype is torch.int64 and readable(buffer):
            buffer.numpy()[()] += number  # takes less than half the time
        else:
            buffer.data.add_(number)
    module._refresh()
