"""MountainCar (Moore 1990) with the same floating-point operations as gymnasium's."""

from __future__ import annotations

import math

from gymnasium.envs.classic_control.mountain_car import MountainCarEnv

from trl_explore.envs.kernels.kernel import Kernel, register_kernel
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.philox import random


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
