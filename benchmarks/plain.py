"""A tuned plain loop for comparison: gymnasium and numpy, one trial after the other.

This is what a careful programmer writes without a framework. The policy uses plain Python floats
in each step; numpy does everything that can wait until the end of the episode; Adam is written by
hand.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

GAMMA, LR, WEIGHT = 0.99, 0.05, 0.05


@dataclass
class Plain:
    """The result of one trial."""

    iterations: int
    converged: bool
    frames: int


def train(strategy: str, seed: int, max_iterations: int = 1000) -> Plain:
    """Train one trial on CartPole-v1 with a strategy of the thesis."""
    draw = random.Random(seed).random
    env = gym.make("CartPole-v1", disable_env_checker=True).unwrapped
    env.reset(seed=seed)
    bound = math.sqrt(6 / 6)
    weight = np.random.default_rng(seed).uniform(-bound, bound, (2, 4))
    first, second = np.zeros((2, 4)), np.zeros((2, 4))
    scores: list[int] = []
    frames = 0
    for i in range(max_iterations):
        epsilon = {"random": 1.0, "argmax": 0.0, "epsilon_greedy": 0.3}.get(strategy, 0.99**i)
        observations, actions = episode(env, weight, draw, strategy == "softmax", epsilon)
        gradient = policy_gradient(weight, np.array(observations), np.array(actions))
        first = 0.9 * first + 0.1 * gradient
        second = 0.999 * second + 0.001 * gradient**2
        step = LR / (1 - 0.9 ** (i + 1))
        weight -= step * first / (np.sqrt(second / (1 - 0.999 ** (i + 1))) + 1e-8)
        frames += len(actions)
        scores.append(len(actions))
        if len(scores) >= 100 and sum(scores[-100:]) / 100 > 195:
            return Plain(i + 1, True, frames)
    return Plain(max_iterations, False, frames)


def episode(
    env: gym.Env,
    weight: NDArray[np.float64],
    draw: Callable[[], float],
    softmax: bool,
    epsilon: float,
) -> tuple[list[NDArray[np.float32]], list[int]]:
    """The observations and actions of one episode of at most 500 steps."""
    w0, w1, w2, w3 = (weight[1] - weight[0]).tolist()
    observation, _ = env.reset()
    step, exp = env.step, math.exp
    observations, actions = [], []
    for _ in range(500):
        x0, x1, x2, x3 = observation.tolist()
        d = w0 * x0 + w1 * x1 + w2 * x2 + w3 * x3
        if softmax:
            action = 1 if draw() < 1 / (1 + exp(-d)) else 0
        elif epsilon and draw() < epsilon:
            action = 1 if draw() < 0.5 else 0
        else:
            action = 1 if d > 0 else 0
        observations.append(observation)
        actions.append(action)
        observation, _, terminated, _, _ = step(action)
        if terminated:
            break
    return observations, actions


def policy_gradient(
    weight: NDArray[np.float64], x: NDArray[np.float32], a: NDArray[np.int64]
) -> NDArray[np.float64]:
    """The gradient of the loss of appendix A.3."""
    n = len(a)
    returns = ((1 - GAMMA ** np.arange(n, 0, -1)) / (1 - GAMMA)).astype(np.float64)
    slope = a - 1 / (1 + np.exp(-(x @ (weight[1] - weight[0]))))
    ascent = (slope * returns) @ x
    return -WEIGHT * np.stack([-ascent, ascent])
