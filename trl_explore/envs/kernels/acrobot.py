"""Acrobot (Sutton 1996) with the same floating-point operations as gymnasium's.

A double pendulum is chaotic: a difference of one bit changes the motion some hundred steps later.
"""

from __future__ import annotations

import math

import numpy as np
from gymnasium.envs.classic_control.acrobot import AcrobotEnv

from trl_explore.envs.kernels.kernel import Kernel, register_kernel
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.elementary import cos32, sin32
from trl_explore.numerics.compiled.philox import random


@kernel_function
def reset(parameters, state, rng):
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
def step(parameters, state, action, rng):
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
def observe(parameters, state, observation):
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
    constants = (
        float(m1 * lc1**2),
        float(l1**2 + lc2**2),
        float(2 * l1 * lc2),
        float(inertia),
        float(m2),
        float(lc2**2),
        float(l1 * lc2),
        float(m2 * l1 * lc2),
        float(2 * m2 * l1 * lc2),
        float((m1 * lc1 + m2 * l1) * g),
        float(m2 * lc2 * g),
        float(m2 * lc2**2 + inertia),
        env.book_or_nips == "nips",
    )
    parameters = (
        constants,
        2.0,
        np.array(env.AVAIL_TORQUE, dtype=np.float64),
        float(env.torque_noise_max),
        float(env.dt),
        float(env.MAX_VEL_1),
        float(env.MAX_VEL_2),
    )
    return Kernel(reset, step, observe, parameters, state_size=5, n_features=6, n_actions=3)
