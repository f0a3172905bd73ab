"""Sine and cosine without a call: the bits of the C library, and what happens where they differ."""

import math

import gymnasium as gym
import numba as nb
import numpy as np
import pytest

from trl_explore.envs.kernels import kernel_of
from trl_explore.envs.kernels.cartpole import step, step_at_any_angle
from trl_explore.numerics import small_angles
from trl_explore.numerics.small_angles import LIMIT, cos_sin


@nb.njit
def evaluate(angles):
    out = np.empty((len(angles), 2))
    for i in range(len(angles)):
        out[i, 0], out[i, 1] = cos_sin(angles[i])
    return out


def angles() -> np.ndarray:
    rng = np.random.default_rng(0)
    magnitudes = 10.0 ** rng.uniform(-12, -0.1, 50_000)
    edges = [0.0, 0.126, np.nextafter(0.126, 0), LIMIT, 1 / 256, 3 / 256, 5e-324]
    both = np.concatenate([magnitudes, rng.uniform(0, LIMIT, 200_000), edges])
    return np.concatenate([both, -both])


def test_the_values_are_right_to_the_last_bit_or_its_neighbour():
    """Against 60-digit values, so that the claim does not rest on another float64 library."""
    mpmath = pytest.importorskip("mpmath")
    x = angles()[::500]
    ours = evaluate(x)
    with mpmath.workdps(60):
        for a, (cos, sin) in zip(x, ours, strict=True):
            for value, exact in ((cos, mpmath.cos(a)), (sin, mpmath.sin(a))):
                assert abs(mpmath.mpf(value) - exact) <= 0.55 * math.ulp(value)


@pytest.mark.skipif(not small_angles.agree(), reason="the C library rounds otherwise")
def test_the_bits_are_those_of_the_library():
    x = angles()
    ours = evaluate(x)
    np.testing.assert_array_equal(ours[:, 0], np.array([math.cos(a) for a in x]))
    np.testing.assert_array_equal(ours[:, 1], np.array([math.sin(a) for a in x]))
    np.testing.assert_array_equal(ours[:, 1], np.sin(x))  # what gymnasium calls


def test_other_angles_and_other_libraries_are_left_to_the_library(monkeypatch):
    env = gym.make("CartPole-v1").unwrapped
    wide = gym.make("CartPole-v1").unwrapped
    wide.theta_threshold_radians = 1.0
    assert kernel_of(wide).step is step_at_any_angle
    assert kernel_of(env).step is (step if small_angles.agree() else step_at_any_angle)
    monkeypatch.setattr(small_angles, "agree", lambda: False)
    assert kernel_of(env).step is step_at_any_angle
