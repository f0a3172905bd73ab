"""Environments: any gymnasium id as one TorchRL environment whose batch dimension is the lanes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import torch
from gymnasium.spaces import Discrete
from torchrl.data import Binary
from torchrl.envs import (
    Compose,
    EnvBase,
    RewardSum,
    StepCounter,
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
    stream: Stream = Stream.ENVIRONMENT,
    workers: int | None = 1,
) -> TransformedEnv:
    """Any gymnasium environment as a TorchRL environment with batch size [trials].

    ``GymWrapper`` over ``LaneVectorEnv``, with the transforms ``StepCounter`` ("step_count") and
    ``RewardSum`` ("episode_reward"). Observations are a vector: a Box is flattened, a Discrete one
    becomes one-hot. Actions are indices, or vectors that the environment sees clipped to its
    bounds; the data keep them as they were drawn. Where gymnasium's environment gives
    ``info["action_mask"]``, "action_mask" [trials, n_actions] (bool) is an observation too.

    Args:
        id: gymnasium id.
        trials: number of lanes.
        max_steps: time limit of an episode; None takes the registered one.
        seed: seed of the job.
        first_trial: trial index of lane 0.
        kwargs: arguments of the environment's constructor.
        attributes: attributes of the built environment to replace: constants that its constructor
            does not take. A kernel reads them from the same environment.
        stream: from which of the trials' streams the environment draws.
        workers: processes that step the lanes, this one among them; None: as many as there are
            processors. Results do not depend on it.

    Raises:
        ValueError: if the environment does not exist, lacks a package, is not of a kind served,
            or has no limit; later, if an observation or reward is not finite.

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
        stream=stream,
        workers=workers,
    )
    env = GymWrapper(lanes, categorical_action_encoding=True)
    if lanes.has_masks:
        n = int(cast(Discrete, lanes.single_action_space).n)
        spec = Binary(n, shape=torch.Size([trials, n]), dtype=torch.bool)
        reader = default_info_dict_reader(["action_mask"], spec=[spec])
        env.set_info_dict_reader(reader)
    transforms = [StepCounter(), RewardSum()]
    return TransformedEnv(env, Compose(*transforms))


def lane_env(env: EnvBase) -> LaneVectorEnv:
    """The lanes within an environment of ``make_env``.

    Raises:
        ValueError: if the environment has none.
    """
    lanes = getattr(getattr(env, "base_env", env), "_env", None)
    if not isinstance(lanes, LaneVectorEnv):
        raise ValueError("the environment has no lanes; build it with trl_explore.envs.make_env")
    return lanes
