"""What a policy reads from the specs of its environment, and what it may be besides."""

from __future__ import annotations

import gymnasium as gym
from torch import nn
from torchrl.data import Bounded, Categorical, Unbounded
from torchrl.envs import EnvBase

from trl_explore.envs import lane_env


def n_actions(env: EnvBase) -> int:
    """The number of actions of an environment with a Categorical action spec."""
    spec = env.action_spec
    if not isinstance(spec, Categorical):
        raise ValueError(
            f"a softmax policy needs a Categorical action spec, got {type(spec).__name__}"
        )
    return spec.n


def n_dims(env: EnvBase) -> int:
    """The number of dimensions of a continuous action.

    Raises:
        ValueError: if the actions are not vectors of real numbers.
    """
    spec = env.action_spec
    if not isinstance(spec, Bounded | Unbounded) or spec.domain != "continuous":
        raise ValueError(
            f"a Gaussian policy needs a Bounded or Unbounded action spec, got {type(spec).__name__}"
        )
    return spec.shape[-1]


def n_features(env: EnvBase) -> int:
    """The length of an observation."""
    return env.observation_spec["observation"].shape[-1]


def observation_space(env: EnvBase) -> gym.Space:
    """The observation space of an environment of ``make_env``, before that made a vector of it."""
    lane = lane_env(env).envs[0]
    if isinstance(lane, gym.wrappers.DtypeObservation):
        lane = lane.env
    if isinstance(lane, gym.wrappers.FlattenObservation):
        lane = lane.env
    return lane.observation_space


def is_one_hot(env: EnvBase) -> bool:
    """Whether the observations are one-hot states."""
    return isinstance(observation_space(env), gym.spaces.Discrete)


def has_hooks(module: nn.Module) -> bool:
    """Whether a call of the module, or of one in it, does more than its ``forward`` says."""
    kinds = ("_forward_hooks", "_forward_pre_hooks", "_backward_hooks", "_backward_pre_hooks")
    return any(getattr(part, kind) for part in module.modules() for kind in kinds)
