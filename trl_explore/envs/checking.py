"""An environment is played before training: is it reproducible, are its transforms supported?"""

from __future__ import annotations

import random
import warnings
from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
import torch
from gymnasium import Wrapper
from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import RewardSum, StepCounter, Transform, TransformedEnv

from trl_explore.checks import first_line
from trl_explore.envs.copies import Copies, EnvError, Outputs
from trl_explore.envs.flattening import shown
from trl_explore.envs.make import lane_env, make_env
from trl_explore.envs.vector import LaneVectorEnv

PLAIN = (TimeLimit, OrderEnforcing, PassiveEnvChecker)
"""Wrappers that keep nothing from one episode to the next."""
STEPS, TRANSFORM_STEPS = 100, 24
"""The number of steps that an environment is played without and with the user's transforms."""


def remarks(lanes: LaneVectorEnv) -> list[str]:
    """What is to be said about an environment, a line each.

    Spaces that are converted are named. The first episode is played twice, in two copies that take
    turns, and then again: an environment that draws numbers from somewhere else than its seeded
    generators, or keeps state from one episode to the next, gives different episodes. gymnasium's
    own environments are known not to.
    """
    env = lanes.envs[0]
    lines: list[str] = []
    flat = isinstance(env.observation_space, Box) and len(env.observation_space.shape) == 1
    if not flat and not isinstance(env.observation_space, Discrete):
        n_features = lanes.outputs.observation.shape[1]
        lines.append(f"observations: {shown(env.observation_space)} as {n_features} numbers")
    if isinstance(env.action_space, MultiDiscrete | MultiBinary):
        n_actions = cast(Discrete, lanes.single_action_space).n
        lines.append(f"actions: {shown(env.action_space)} as its {n_actions} combinations")
    fault = _fault_of(lanes)
    return [*lines, f"environment {lanes.id!r} {fault}"] if fault else lines


KEEPS = "keeps state from one episode to the next, as gymnasium.wrappers.NormalizeObservation does"


def check_resumable(lanes: LaneVectorEnv) -> None:
    """Refuse to resume a job whose environment keeps state that checkpoints do not hold.

    Raises:
        ValueError: if the first episode is another one after it has been played.
    """
    if (_fault_of(lanes) or "").startswith(KEEPS):
        raise ValueError(
            f"environment {lanes.id!r} {KEEPS}; the checkpoint does not hold it, so this job "
            "cannot go on as if it had not been interrupted; restart=true starts over"
        )


def _fault_of(lanes: LaneVectorEnv) -> str | None:
    """Why two plays of the first episode differ; None if they are equal."""
    env = lanes.envs[0]
    while type(env) in PLAIN:
        env = cast(Wrapper[Any, Any, Any, Any], env).env
    if type(env).__module__.startswith("gymnasium.envs."):
        return None
    copies = Copies(
        lanes.id,
        lanes.make,
        Outputs.of(2, lanes.outputs.observation.shape[1], lanes.outputs.mask.shape[1]),
    )
    before = _global_states()
    try:
        first = _episode(lanes, copies)
        again = _episode(lanes, copies)
    except EnvError:
        return None  # training meets the same error, and reports it
    finally:
        copies.close()
    after = _global_states()
    if drawn := [name for name, state in before.items() if state != after[name]]:
        return (
            f"draws from the global generator of {' and '.join(drawn)}, "
            "which its trials share: results depend on the number of trials, and may differ "
            "between runs; draw from self.np_random"
        )
    for step, columns in enumerate(first):
        if any((column[0] != column[1]).any() for column in columns):
            return (
                "is not reproducible: its first episode, played twice from "
                f"one seed, differs at step {step}; draw from self.np_random, or from a generator "
                "that reset(seed=...) seeds"
            )
    same = len(first) == len(again) and all(
        np.array_equal(ours, theirs)
        for pair in zip(first, again, strict=True)
        for ours, theirs in zip(*pair, strict=True)
    )
    return None if same else f"{KEEPS}: if this job is interrupted, it can only start over"


def _episode(lanes: LaneVectorEnv, copies: Copies) -> list[list[NDArray[Any]]]:
    """The outputs of the first episode in two copies, step by step, with random actions."""
    outputs, draws = copies.outputs, np.random.default_rng(0)
    copies.reset([0, 1], [lanes.first_trial] * 2, [0, 0], lanes.seed, lanes.stream)
    seen = [[column.copy() for column in outputs]]
    for _ in range(STEPS):
        if outputs.terminated.any() or outputs.truncated.any():
            break
        copies.step([0, 1], np.repeat(_action(lanes, outputs, draws), 2, 0))
        seen.append([column.copy() for column in outputs])
    return seen


def _action(lanes: LaneVectorEnv, outputs: Outputs, draws: np.random.Generator) -> Any:
    """A random action [1] or [1, n_dims] that the mask allows."""
    space = lanes.single_action_space
    if isinstance(space, Discrete):
        n = int(space.n)
        allowed = np.flatnonzero(outputs.mask[0]) if lanes.has_masks else np.arange(n)
        return draws.choice(allowed if len(allowed) else n, 1)
    return draws.uniform(-1, 1, (1, *(space.shape or ()))).astype(np.float32)


def _global_states() -> dict[str, Any]:
    """The states of the generators that belong to no environment."""
    legacy = cast(tuple[Any, ...], np.random.get_state())  # noqa: NPY002
    states = {"random": random.getstate(), "numpy.random": (legacy[1].tobytes(), *legacy[2:])}
    states["torch"] = torch.get_rng_state().numpy().tobytes()
    return states


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
    """What an environment returns for fixed actions, with a new episode of trial 0 on the way."""
    lanes = lane_env(env)
    steps = 0

    def advance(lanes_: NDArray[np.int64], actions: NDArray[Any]) -> None:
        nonlocal steps, ends
        steps += 1
        LaneVectorEnv.advance(lanes, lanes_, actions)
        ends = {name: getattr(lanes.outputs, name).copy() for name in ("terminated", "truncated")}

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
        for t in range(TRANSFORM_STEPS):
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
            if t == TRANSFORM_STEPS // 2 and lanes.first_trial == 0:
                again = torch.arange(lanes.num_envs).unsqueeze(-1) == 0
                td = env.reset(td.set("_reset", again)).exclude("_reset")
    finally:
        env.close()
    return data
