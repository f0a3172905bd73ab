"""Which transforms are served: those that keep trials apart and do not move ends of episodes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import RewardSum, StepCounter, Transform, TransformedEnv

from trl_explore.checks import first_line
from trl_explore.envs.copies import EnvError
from trl_explore.envs.make import lane_env, make_env
from trl_explore.envs.vector import LaneVectorEnv

STEPS = 24
"""The number of steps of the check."""


def check_transforms(
    build: Callable[[], Sequence[Transform]], make: Callable[..., TransformedEnv] = make_env
) -> None:
    """Play two trials together and each alone, and compare all that the transforms make.

    A transform may keep state, such as the last frames of each trial. It must not mix trials, as
    running means over the batch do, nor change where an episode ends, nor step the environment more
    than once.

    Args:
        build: makes the transforms; each environment has its own.
        make: makes the environments, ``make_env`` with some of its arguments.

    Raises:
        ValueError: if a transform fails, or does what it must not; one line with its name.

    Example:
        >>> from torchrl.envs import CatFrames, VecNormV2
        >>> check_transforms(lambda: [CatFrames(4, dim=-1, in_keys=["observation"])])
        >>> check_transforms(lambda: [VecNormV2(in_keys=["observation"])])  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        ...
        ValueError: the transform VecNormV2 mixes trials or draws random numbers: ...
    """
    names = [_check_kind(transform) for transform in build()]
    if not names or _fault(build, make) is None:
        return
    for k, name in enumerate(names, 1):  # the first one that is at fault
        fault = _fault(lambda k=k: build()[:k], make)
        if fault is not None:
            raise ValueError(f"the transform {name} {fault}")


def _check_kind(transform: object) -> str:
    name = type(transform).__name__
    if not isinstance(transform, Transform):
        raise ValueError(f"{name} is not a torchrl.envs.transforms.Transform")
    if isinstance(transform, StepCounter | RewardSum):
        raise ValueError(
            f"every environment has a {name} already; env.max_steps sets the time limit"
        )
    return name


def _fault(
    build: Callable[[], Sequence[Transform]], make: Callable[..., TransformedEnv]
) -> str | None:
    """What is wrong with some transforms; None: nothing."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the training itself warns
            together, *alone = (
                _play(make(trials=n, first_trial=k, transforms=build()))
                for n, k in ((2, 0), (1, 0), (1, 1))
            )
    except EnvError:
        raise
    except _FaultError as error:
        return str(error)
    except Exception as error:
        return f"fails: {type(error).__name__}: {first_line(error)}"
    for data, *own in zip(together, *alone, strict=True):
        for lane in range(2):
            for key, value in data.items(True, True):
                other = own[lane].get(key, None)
                if other is None or not torch.equal(other[0], value[lane]):
                    name = key if isinstance(key, str) else ".".join(key)
                    return (
                        "mixes trials or draws random numbers: "
                        f"{name} of a trial is not the same when it runs alone"
                    )
    return None


class _FaultError(Exception):
    """What a transform must not do."""


@torch.no_grad()
def _play(env: TransformedEnv) -> list[TensorDictBase]:
    """What an environment returns while its lanes are stepped with fixed actions."""
    lanes = lane_env(env)
    steps = 0

    def advance(lanes_: NDArray[np.int64], actions: NDArray[Any]) -> None:
        nonlocal steps, ends
        steps += 1
        LaneVectorEnv.advance(lanes, lanes_, actions)
        ends = {name: getattr(lanes.signals, name).copy() for name in ("terminated", "truncated")}

    ends: dict[str, NDArray[np.bool_]] = {}
    lanes.advance = advance  # pyright: ignore
    data: list[TensorDictBase] = []
    try:
        td = env.reset()
        observation = td.get("observation")
        if observation.ndim != 2 or observation.dtype != torch.float32:
            raise _FaultError(
                f"makes observations of shape {list(observation.shape[1:])}, {observation.dtype}, "
                "but must make vectors of torch.float32"
            )
        for t in range(STEPS):
            action = env.action_spec.zero()
            if lanes.has_masks:
                action = td.get("action_mask").int().argmax(-1)
            frame, td = env.step_and_maybe_reset(td.set("action", action))
            data.append(frame.clone())
            if steps != t + 1:
                raise _FaultError("steps the environment more than once; use a gymnasium wrapper")
            for name, end in ends.items():
                if frame["next", name].flatten().tolist() != end.tolist():
                    raise _FaultError(f"changes {name}, which must stay the environment's own")
    finally:
        env.close()
    return data
