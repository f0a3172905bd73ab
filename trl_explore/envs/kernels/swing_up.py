"""A pendulum that must be swung up with a weak motor, rewarded only where it is up."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete
from numpy.typing import NDArray

from trl_explore.checks import check_number
from trl_explore.envs.kernels.bsuite import ExplorationTask
from trl_explore.envs.kernels.kernel import Kernel, register_kernel
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.philox import random

TORQUE, GRAVITY, STEP, FASTEST = 2.0, 10.0, 0.05, 8.0
"""Those of gymnasium's Pendulum: torque [N m], gravity [m/s²], time step [s], speed [rad/s]."""
UPRIGHT, SLOW, NOISE = 0.95, 1.0, 0.05
"""The cosine above which the pendulum is up, the speed below which it is slow [rad/s], and the
largest deviation at the start from hanging at rest."""


class SwingUp(ExplorationTask):
    """gymnasium's Pendulum with the torques −2, 0 and 2, and a reward only where it is up.

    θ̈ = 15 sin θ + 3 u for angle θ (0 is up), torque u, mass 1 kg and length 1 m, in steps of
    0.05 s; the speed is limited to 8 rad/s. It begins hanging down. A step is worth 1 if
    cos θ > 0.95 and |θ̇| < 1 after it, minus ``move_cost`` if it has a torque. The torque is too
    weak to lift the pendulum at once, so it must be swung, and every step of that only costs: doing
    nothing, which returns 0, is better than all that does not come up.

    The observation is (cos θ, sin θ, θ̇). The reward is that of cartpole swing-up in Osband et al.
    2020, "Behaviour suite for reinforcement learning".

    Args:
        move_cost: the cost of a step with a torque, from 0 to 1.

    Raises:
        ValueError: if the cost is out of range.

    Example:
        >>> observation, _ = SwingUp().reset(seed=0)
        >>> bool(observation[0] < -0.99)
        True
    """

    def __init__(self, move_cost: float = 0.1) -> None:
        self.move_cost = check_number("move_cost", move_cost, 0, 1)
        high = np.array([1.0, 1.0, FASTEST], dtype=np.float32)
        self.observation_space = Box(-high, high, dtype=np.float32)
        self.action_space = Discrete(3)
        self.theta = self.speed = 0.0

    def _begin(self) -> None:
        self.theta = math.pi + NOISE * (2.0 * self.np_random.random() - 1.0)
        self.speed = NOISE * (2.0 * self.np_random.random() - 1.0)

    def step(self, action: int) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Apply −torque, none, or torque; no step ends the episode."""
        torque = TORQUE * (int(action) - 1)
        acceleration = 1.5 * GRAVITY * math.sin(self.theta) + 3.0 * torque
        self.speed = min(max(self.speed + acceleration * STEP, -FASTEST), FASTEST)
        self.theta += self.speed * STEP
        up = math.cos(self.theta) > UPRIGHT and abs(self.speed) < SLOW
        cost = 0.0 if action == 1 else self.move_cost
        return self._observation(), (1.0 if up else 0.0) - cost, False, False, {}

    def _observation(self) -> NDArray[np.float32]:
        values = [math.cos(self.theta), math.sin(self.theta), self.speed]
        return np.array(values, dtype=np.float32)


@kernel_function
def swing_reset(parameters, state, rng):
    """Angle and speed: hanging down, nearly at rest."""
    state[0] = math.pi + NOISE * (2.0 * random(rng) - 1.0)
    state[1] = NOISE * (2.0 * random(rng) - 1.0)


@kernel_function
def swing_step(parameters, state, action, rng):
    """Apply −torque, none, or torque."""
    (move_cost,) = parameters
    torque = TORQUE * (action - 1)
    acceleration = 1.5 * GRAVITY * math.sin(state[0]) + 3.0 * torque
    state[1] = min(max(state[1] + acceleration * STEP, -FASTEST), FASTEST)
    state[0] += state[1] * STEP
    up = math.cos(state[0]) > UPRIGHT and abs(state[1]) < SLOW
    cost = 0.0 if action == 1 else move_cost
    return (1.0 if up else 0.0) - cost, False


@kernel_function
def swing_observe(parameters, state, observation):
    """Cosine and sine of the angle, and the speed."""
    observation[0], observation[1] = math.cos(state[0]), math.sin(state[0])
    observation[2] = state[1]


@register_kernel(SwingUp)
def swing_up(env: SwingUp) -> Kernel:
    """The kernel of a SwingUp environment."""
    functions = swing_reset, swing_step, swing_observe
    return Kernel(*functions, (env.move_cost,), state_size=2, n_features=3, n_actions=3)
