"""MountainCar (Moore 1990) with the same floating-point operations as gymnasium's, also sparse."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.envs.classic_control.mountain_car import MountainCarEnv
from numpy.typing import NDArray

from trl_explore.envs.kernels.kernel import Kernel, register_kernel
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.philox import random


class SparseMountainCar(MountainCarEnv):
    """gymnasium's MountainCar with the reward 1 at the goal and 0 elsewhere.

    The return says nothing before the goal has been reached for the first time, which uniformly
    random actions take tens of thousands of steps to do. The best return is 1.

    Example:
        >>> env = SparseMountainCar()
        >>> _ = env.reset(seed=0)
        >>> env.step(2)[1]
        0.0
    """

    def step(self, action: int) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """A step of MountainCar with another reward."""
        observation, _, terminated, truncated, info = super().step(action)
        return observation, float(terminated), terminated, truncated, info


@kernel_function
def reset(parameters, state, rng):
    """At rest, x ~ U(−0.6, −0.4)."""
    state[0] = -0.6 + (-0.4 - -0.6) * random(rng)
    state[1] = 0.0


@kernel_function
def step(parameters, state, action, rng):
    """One step: gravity along the slope, and a push to the left, no push, or one to the right."""
    (force, gravity, max_speed, min_position, max_position, goal_position, goal_velocity) = (
        parameters
    )
    position, velocity = state[0], state[1]
    velocity = velocity + ((action - 1) * force + math.cos(3 * position) * (-gravity))
    velocity = min(max(velocity, -max_speed), max_speed)
    position = min(max(position + velocity, min_position), max_position)
    if position == min_position and velocity < 0:
        velocity = 0.0
    state[0], state[1] = position, velocity
    return -1.0, position >= goal_position and velocity >= goal_velocity


@kernel_function
def sparse_step(parameters, state, action, rng):
    """A step of MountainCar; the reward is 1 at the goal, else 0."""
    _, terminated = step(parameters, state, action, rng)
    return 1.0 if terminated else 0.0, terminated


@kernel_function
def observe(parameters, state, observation):
    """Position and velocity."""
    observation[0], observation[1] = state[0], state[1]


@register_kernel(MountainCarEnv)
def mountain_car(env: MountainCarEnv) -> Kernel:
    """The kernel of a MountainCar environment, with the constants of this instance."""
    parameters = (
        float(env.force),
        float(env.gravity),
        float(env.max_speed),
        float(env.min_position),
        float(env.max_position),
        float(env.goal_position),
        float(env.goal_velocity),
    )
    return Kernel(reset, step, observe, parameters, state_size=2, n_features=2, n_actions=3)


@register_kernel(SparseMountainCar)
def sparse_mountain_car(env: SparseMountainCar) -> Kernel:
    """The kernel of MountainCar with its reward replaced."""
    return replace(mountain_car(env), step=sparse_step)
