"""``make_env``: any gymnasium id as one TorchRL environment, with the lanes as batch dimension."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, cast

import gymnasium as gym
import torch
from gymnasium.spaces import Discrete
from torchrl.data import Binary
from torchrl.envs import (
    Compose,
    EnvBase,
    RewardSum,
    StepCounter,
    Transform,
    TransformedEnv,
    default_info_dict_reader,
)
from torchrl.envs.libs.gym import GymWrapper

from trl_explore.envs.vector import LaneVectorEnv
from trl_explore.numerics.streams import Stream

__all__ = ["LaneVectorEnv", "lane_env", "make_env"]


def make_env(
    id: str = "CartPole-v1",
    trials: int = 1,
    max_steps: int | None = None,
    *,
    seed: int = 0,
    first_trial: int = 0,
    kwargs: Mapping[str, Any] | None = None,
    attributes: Mapping[str, Any] | None = None,
    wrappers: Sequence[Callable[[gym.Env], gym.Env]] = (),
    transforms: Sequence[Transform] = (),
    stream: Stream = Stream.ENVIRONMENT,
    workers: int | None = 1,
) -> TransformedEnv:
    """Any gymnasium environment as a TorchRL environment with batch size [trials].

    It is a ``GymWrapper`` over ``LaneVectorEnv``, with the transforms ``StepCounter``
    ("step_count") and ``RewardSum`` ("episode_reward"), followed by the user's transforms: the
    policy and the loss see what these make, and the score stays that of the environment.
    Observations are vectors: a Box is flattened, a Discrete one is one-hot encoded, the parts of a
    Dict or a Tuple follow each other. Actions are indices, or vectors; the environment gets vectors
    clipped to its bounds, and the data keep them as drawn. If the gymnasium environment has
    ``info["action_mask"]``, there is an observation "action_mask" [trials, n_actions] (bool).

    Args:
        id: gymnasium id; ``torchrl:module.Class`` is a TorchRL environment of batch size [].
        trials: number of lanes.
        max_steps: time limit of an episode; None means the registered limit.
        seed: seed of the job.
        first_trial: trial index of lane 0.
        kwargs: arguments of the environment's constructor.
        attributes: attributes to replace after construction: constants that the constructor does
            not take. A kernel reads them from the same environment.
        wrappers: gymnasium wrappers, from the inside to the outside; each trial has its own.
        transforms: TorchRL transforms, in this order; ``check_transforms`` checks them.
        stream: the random stream of each trial that the environment uses.
        workers: number of processes that step the lanes, including this one; None: one per
            processor. Results do not depend on it.

    Raises:
        ValueError: if the environment does not exist, lacks a package, is not supported, or has no
            time limit; later, if an observation or reward is not finite.

    Example:
        >>> make_env("CartPole-v1", trials=3).rollout(2)["observation"].shape
        torch.Size([3, 2, 4])
    """
    lanes = LaneVectorEnv(
        id,
        trials,
        max_steps,
        seed=seed,
        first_trial=first_trial,
        kwargs=kwargs,
        attributes=attributes,
        wrappers=wrappers,
        stream=stream,
        workers=workers,
    )
    env = GymWrapper(lanes, categorical_action_encoding=True)
    if lanes.has_masks:
        n = int(cast(Discrete, lanes.single_action_space).n)
        spec = Binary(n, shape=torch.Size([trials, n]), dtype=torch.bool)
        reader = default_info_dict_reader(["action_mask"], spec=[spec])
        env.set_info_dict_reader(reader)
    return TransformedEnv(env, Compose(*[StepCounter(), RewardSum(), *transforms]))


def own_transforms(env: EnvBase) -> list[Transform]:
    """The transforms of an environment of ``make_env`` that its user has added."""
    return list(cast(Iterable[Transform], cast(TransformedEnv, env).transform))[2:]


def lane_env(env: EnvBase) -> LaneVectorEnv:
    """The ``LaneVectorEnv`` inside an environment made by ``make_env``.

    Raises:
        ValueError: if there is none.
    """
    lanes = getattr(getattr(env, "base_env", env), "_env", None)
    if not isinstance(lanes, LaneVectorEnv):
        raise ValueError("the environment has no lanes; build it with trl_explore.envs.make_env")
    return lanes
