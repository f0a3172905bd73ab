"""CartPole (Barto, Sutton & Anderson 1983) with the same operations as gymnasium's."""

from __future__ import annotations

import math

from gymnasium.envs.classic_control.cartpole import CartPoleEnv

from trl_explore.envs.kernels.kernel import Kernel, register_kernel
from trl_explore.numerics.compiled import elementary
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.elementary import cos_sin
from trl_explore.numerics.compiled.philox import random


@kernel_function
def reset(parameters, state, rng):
    """x, ẋ, θ, θ̇ ~ U(−0.05, 0.05)."""
    for i in range(4):
        state[i] = -0.05 + (0.05 - -0.05) * random(rng)


@kernel_function
def step(parameters, state, action, rng):
    """One step, if every episode ends before |θ| exceeds ``MAX_ANGLE``."""
    cos, sin = cos_sin(state[2])
    return advance(parameters, state, action, cos, sin)


@kernel_function
def step_at_any_angle(parameters, state, action, rng):
    """One step, for any angle."""
    return advance(parameters, state, action, math.cos(state[2]), math.sin(state[2]))


@kernel_function
def advance(parameters, state, action, cos, sin):
    """Integrate ``tau`` seconds with a force of ±``force_mag``, with sums in gymnasium's order."""
    (gravity, masspole, total_mass, length, polemass_length, force_mag, tau,
     x_threshold, theta_threshold, euler, alive, fallen) = parameters  # fmt: skip
    x, x_dot, theta, theta_dot = state[0], state[1], state[2], state[3]
    force = force_mag if action == 1 else -force_mag
    temp = (force + polemass_length * (theta_dot * theta_dot) * sin) / total_mass
    theta_acc = (gravity * sin - cos * temp) / (
        length * (4.0 / 3.0 - masspole * (cos * cos) / total_mass)
    )
    x_acc = temp - polemass_length * theta_acc * cos / total_mass
    if euler:
        x = x + tau * x_dot
        x_dot = x_dot + tau * x_acc
        theta = theta + tau * theta_dot
        theta_dot = theta_dot + tau * theta_acc
    else:
        x_dot = x_dot + tau * x_acc
        x = x + tau * x_dot
        theta_dot = theta_dot + tau * theta_acc
        theta = theta + tau * theta_dot
    state[0], state[1], state[2], state[3] = x, x_dot, theta, theta_dot
    terminated = abs(x) > x_threshold or abs(theta) > theta_threshold
    return (fallen if terminated else alive), terminated


@kernel_function
def observe(parameters, state, observation):
    """The state itself."""
    for i in range(4):
        observation[i] = state[i]


@register_kernel(CartPoleEnv)
def cartpole(env: CartPoleEnv) -> Kernel:
    """The kernel of a CartPole environment, with the constants of this instance."""
    sutton_barto = env._sutton_barto_reward
    parameters = (
        float(env.gravity),
        float(env.masspole),
        float(env.total_mass),
        float(env.length),
        float(env.polemass_length),
        float(env.force_mag),
        float(env.tau),
        float(env.x_threshold),
        float(env.theta_threshold_radians),
        env.kinematics_integrator == "euler",
        0.0 if sutton_barto else 1.0,
        -1.0 if sutton_barto else 1.0,
    )
    small = env.theta_threshold_radians <= elementary.MAX_ANGLE and elementary.agree()
    by = step if small else step_at_any_angle
    return Kernel(reset, by, observe, parameters, state_size=4, n_features=4, n_actions=2)
