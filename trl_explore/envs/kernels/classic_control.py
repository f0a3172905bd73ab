"""gymnasium's CartPole, MountainCar (also sparse) and Acrobot, with the same operations."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.envs.classic_control.acrobot import AcrobotEnv
from gymnasium.envs.classic_control.cartpole import CartPoleEnv
from gymnasium.envs.classic_control.mountain_car import MountainCarEnv
from numpy.typing import NDArray

from trl_explore.envs.kernels.kernel import Kernel, register_kernel
from trl_explore.numerics.compiled import elementary
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.elementary import cos32, cos_sin, sin32
from trl_explore.numerics.compiled.philox import random


def _floats(env: Any, *names: str) -> tuple[float, ...]:
    """The constants of an environment."""
    return tuple(float(getattr(env, name)) for name in names)


# CartPole (Barto, Sutton & Anderson 1983)


@kernel_function
def cartpole_reset(parameters, state, rng):
    """x, ẋ, θ, θ̇ ~ U(−0.05, 0.05)."""
    for i in range(4):
        state[i] = -0.05 + (0.05 - -0.05) * random(rng)


@kernel_function
def cartpole_step(parameters, state, action, rng):
    """One step, if every episode ends before |θ| exceeds ``MAX_ANGLE``."""
    cos, sin = cos_sin(state[2])
    return cartpole_advance(parameters, state, action, cos, sin)


@kernel_function
def cartpole_step_at_any_angle(parameters, state, action, rng):
    """One step, for any angle."""
    return cartpole_advance(parameters, state, action, math.cos(state[2]), math.sin(state[2]))


@kernel_function
def cartpole_advance(parameters, state, action, cos, sin):
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
def cartpole_observe(parameters, state, observation):
    """The state itself."""
    for i in range(4):
        observation[i] = state[i]


@register_kernel(CartPoleEnv)
def cartpole(env: CartPoleEnv) -> Kernel:
    """The kernel of a CartPole environment, with the constants of this instance."""
    parameters = (
        *_floats(env, "gravity", "masspole", "total_mass", "length", "polemass_length"),
        *_floats(env, "force_mag", "tau", "x_threshold", "theta_threshold_radians"),
        env.kinematics_integrator == "euler",
        *((0.0, -1.0) if env._sutton_barto_reward else (1.0, 1.0)),
    )
    small = env.theta_threshold_radians <= elementary.MAX_ANGLE and elementary.agree()
    by = cartpole_step if small else cartpole_step_at_any_angle
    return Kernel(
        cartpole_reset, by, cartpole_observe, parameters, state_size=4, n_features=4, n_actions=2
    )


# MountainCar (Moore 1990)


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
def car_reset(parameters, state, rng):
    """At rest, x ~ U(−0.6, −0.4)."""
    state[0] = -0.6 + (-0.4 - -0.6) * random(rng)
    state[1] = 0.0


@kernel_function
def car_step(parameters, state, action, rng):
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
def sparse_car_step(parameters, state, action, rng):
    """A step of MountainCar; the reward is 1 at the goal, else 0."""
    _, terminated = car_step(parameters, state, action, rng)
    return 1.0 if terminated else 0.0, terminated


@kernel_function
def car_observe(parameters, state, observation):
    """Position and velocity."""
    observation[0], observation[1] = state[0], state[1]


@register_kernel(MountainCarEnv)
def mountain_car(env: MountainCarEnv) -> Kernel:
    """The kernel of a MountainCar environment, with the constants of this instance."""
    names = "force", "gravity", "max_speed", "min_position", "max_position"
    parameters = _floats(env, *names, "goal_position", "goal_velocity")
    return Kernel(
        car_reset, car_step, car_observe, parameters, state_size=2, n_features=2, n_actions=3
    )


@register_kernel(SparseMountainCar)
def sparse_mountain_car(env: SparseMountainCar) -> Kernel:
    """The kernel of MountainCar with its reward replaced."""
    return replace(mountain_car(env), step=sparse_car_step)


# Acrobot (Sutton 1996): a double pendulum is chaotic: a difference of one bit changes the motion
# some hundred steps later.


@kernel_function
def acrobot_reset(parameters, state, rng):
    """θ₁, θ₂ and their velocities ~ U(−0.1, 0.1), rounded to float32."""
    for i in range(4):
        state[i] = np.float32(-0.1 + (0.1 - -0.1) * random(rng))
    state[4] = 1.0


@kernel_function
def derivative(constants, two, torque, theta1, theta2, dtheta1, dtheta2):
    """The accelerations θ̈₁, θ̈₂ for a torque on the joint between the links.

    ``two`` is 2. As a variable it keeps the compiler from replacing ``pow``, which gymnasium's
    ``** 2`` calls, by a product, which rounds differently in one case of a thousand.
    """
    (m1lc1, lengths, coupling, inertia, m2, lc2_lc2, l1lc2, coriolis, twice, weight1, weight2,
     own_inertia, nips) = constants  # fmt: skip
    cos2, sin2 = math.cos(theta2), math.sin(theta2)
    d1 = m1lc1 + m2 * (lengths + coupling * cos2) + inertia + inertia
    d2 = m2 * (lc2_lc2 + l1lc2 * cos2) + inertia
    phi2 = weight2 * math.cos(theta1 + theta2 - math.pi / 2.0)
    phi1 = (
        -coriolis * math.pow(dtheta2, two) * sin2
        - twice * dtheta2 * dtheta1 * sin2
        + weight1 * math.cos(theta1 - math.pi / 2)
        + phi2
    )
    free = own_inertia - math.pow(d2, two) / d1
    if nips:
        ddtheta2 = (torque + d2 / d1 * phi1 - phi2) / free
    else:
        spin = coriolis * math.pow(dtheta1, two) * sin2
        ddtheta2 = (torque + d2 / d1 * phi1 - spin - phi2) / free
    return -(d2 * ddtheta2 + phi1) / d1, ddtheta2


@kernel_function
def wrap(angle):
    """The angle wrapped to [−π, π]."""
    while angle > math.pi:
        angle = angle - 2 * math.pi
    while angle < -math.pi:
        angle = angle + 2 * math.pi
    return angle


@kernel_function
def acrobot_step(parameters, state, action, rng):
    """One step of the classical Runge–Kutta method."""
    constants, two, torques, noise, dt, max1, max2 = parameters
    torque = torques[action]
    if noise > 0:
        torque = torque + (-noise + (noise - -noise) * random(rng))
    t1, t2, v1, v2 = state[0], state[1], state[2], state[3]
    half = dt / 2.0
    a1, a2 = derivative(constants, two, torque, t1, t2, v1, v2)
    p1, p2, q1, q2 = t1 + half * v1, t2 + half * v2, v1 + half * a1, v2 + half * a2
    b1, b2 = derivative(constants, two, torque, p1, p2, q1, q2)
    r1, r2, s1, s2 = t1 + half * q1, t2 + half * q2, v1 + half * b1, v2 + half * b2
    c1, c2 = derivative(constants, two, torque, r1, r2, s1, s2)
    u1, u2, w1, w2 = t1 + dt * s1, t2 + dt * s2, v1 + dt * c1, v2 + dt * c2
    d1, d2 = derivative(constants, two, torque, u1, u2, w1, w2)
    sixth = dt / 6.0
    t1 = wrap(t1 + sixth * (v1 + 2 * q1 + 2 * s1 + w1))
    t2 = wrap(t2 + sixth * (v2 + 2 * q2 + 2 * s2 + w2))
    v1 = v1 + sixth * (a1 + 2 * b1 + 2 * c1 + d1)
    v2 = v2 + sixth * (a2 + 2 * b2 + 2 * c2 + d2)
    state[0], state[1] = t1, t2
    state[2], state[3] = min(max(v1, -max1), max1), min(max(v2, -max2), max2)
    state[4] = 0.0
    terminated = -math.cos(t1) - math.cos(t2 + t1) > 1.0
    return (0.0 if terminated else -1.0), terminated


@kernel_function
def acrobot_observe(parameters, state, observation):
    """Cosine and sine of both angles, and the velocities; computed in float32 at reset."""
    for i in range(2):
        if state[4] == 1:
            angle = np.float32(state[i])
            observation[2 * i], observation[2 * i + 1] = cos32(angle), sin32(angle)
        else:
            observation[2 * i], observation[2 * i + 1] = math.cos(state[i]), math.sin(state[i])
    observation[4], observation[5] = state[2], state[3]


@register_kernel(AcrobotEnv)
def acrobot(env: AcrobotEnv) -> Kernel:
    """The kernel of an Acrobot environment, with the constants of this instance."""
    m1, m2, l1 = env.LINK_MASS_1, env.LINK_MASS_2, env.LINK_LENGTH_1
    lc1, lc2, inertia, g = env.LINK_COM_POS_1, env.LINK_COM_POS_2, env.LINK_MOI, 9.8
    numbers = (
        *(m1 * lc1**2, l1**2 + lc2**2, 2 * l1 * lc2, inertia, m2, lc2**2, l1 * lc2),
        *(m2 * l1 * lc2, 2 * m2 * l1 * lc2, (m1 * lc1 + m2 * l1) * g, m2 * lc2 * g),
        m2 * lc2**2 + inertia,
    )
    constants = (*map(float, numbers), env.book_or_nips == "nips")
    torques = np.array(env.AVAIL_TORQUE, dtype=np.float64)
    names = "torque_noise_max", "dt", "MAX_VEL_1", "MAX_VEL_2"
    parameters = (constants, 2.0, torques, *_floats(env, *names))
    functions = acrobot_reset, acrobot_step, acrobot_observe
    return Kernel(*functions, parameters, state_size=5, n_features=6, n_actions=3)
