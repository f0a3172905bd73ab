import math

import gymnasium as gym
import numba as nb
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trl_explore.envs.kernels import kernel_of
from trl_explore.envs.kernels.classic_control import cartpole_step, cartpole_step_at_any_angle
from trl_explore.numerics.compiled import elementary
from trl_explore.numerics.compiled.elementary import MAX_ANGLE, cos_sin, exp32, log1p32, log32


@nb.njit(error_model="numpy")
def exp_all(x, y):
    for i in range(len(x)):
        y[i] = exp32(x[i])


@nb.njit(error_model="numpy")
def log_all(x, y):
    for i in range(len(x)):
        y[i] = log32(x[i])


@nb.njit(error_model="numpy")
def log1p_all(x, y):
    for i in range(len(x)):
        y[i] = log1p32(x[i])


EXACT = {exp_all: np.exp, log_all: np.log, log1p_all: np.log1p}
FUNCTIONS = pytest.mark.parametrize("function", EXACT)


def of(function, x):
    x = np.atleast_1d(np.asarray(x, dtype=np.float32))
    y = np.empty_like(x)
    function(x, y)
    return y


def units(function, x):
    """The largest distance from the exact value, in units of the last place."""
    x = np.atleast_1d(np.asarray(x, dtype=np.float32))
    exact = EXACT[function](x.astype(np.float64))
    place = np.spacing(np.abs(exact).astype(np.float32)).astype(np.float64)
    return np.max(np.abs(of(function, x).astype(np.float64) - exact) / place)


@pytest.mark.parametrize(
    ("function", "x"),
    [
        (exp_all, np.linspace(-103.2, 88.72, 100_001)),
        (exp_all, np.linspace(-1, 1, 100_001)),
        (exp_all, -np.geomspace(1e-30, 1, 20_001)),
        (log_all, np.geomspace(1e-44, 3.4e38, 100_001)),
        (log_all, np.linspace(0.4, 3, 100_001)),
        (log_all, 1 + np.linspace(-1e-3, 1e-3, 20_001)),
        (log1p_all, np.linspace(0, 1, 100_001)),
        (log1p_all, np.geomspace(1e-44, 1, 50_001)),
    ],
)
def test_units_in_the_last_place(function, x):
    assert units(function, x) < 1.5


@given(st.floats(width=32, min_value=-103, max_value=88))
def test_exponential_of_any_number(x):
    assert units(exp_all, x) < 1.5


@given(st.floats(width=32, min_value=0, exclude_min=True, allow_infinity=False))
def test_logarithm_of_any_number(x):
    assert units(log_all, x) < 1.5


@given(st.floats(width=32, min_value=0, max_value=1))
def test_logarithm_of_one_and_any_number(x):
    assert units(log1p_all, x) < 1.5


def test_ends():
    assert of(exp_all, [0, -np.inf, -200, np.inf, 88.73, 3e38]).tolist() == [
        *(1, 0, 0, np.inf, np.inf, np.inf),
    ]
    assert of(log_all, [1, 0, np.inf]).tolist() == [0, -np.inf, np.inf]
    assert of(log1p_all, 0).tolist() == [0]
    assert np.isnan(of(log_all, [-1, -np.inf])).all()


@FUNCTIONS
def test_nan_stays_nan(function):
    assert np.isnan(of(function, [np.nan, -np.nan])).all()


@FUNCTIONS
def test_a_number_does_not_depend_on_its_place(function):
    x = np.random.default_rng(0).uniform(0.01, 1, 200).astype(np.float32)
    whole = of(function, x)
    for first in range(40):
        for size in (1, 2, 3, 7, 8, 9, 31, 64):
            part = slice(first, first + size)
            np.testing.assert_array_equal(of(function, x[part]), whole[part])


@FUNCTIONS
def test_a_loop_becomes_vector_instructions(function):
    of(function, [1.0])
    code = function.inspect_asm(function.signatures[0])
    assert "call" not in [line.split()[0] for line in code.splitlines() if line.split()]
    packed = ("mulps", "fmul.4s", "fmul\tv")
    assert any(name in code for name in packed)


# Sine and cosine: the bits of the C library, and what happens where they differ


@nb.njit
def evaluate(angles):
    out = np.empty((len(angles), 2))
    for i in range(len(angles)):
        out[i, 0], out[i, 1] = cos_sin(angles[i])
    return out


def angles() -> np.ndarray:
    rng = np.random.default_rng(0)
    magnitudes = 10.0 ** rng.uniform(-12, -0.1, 50_000)
    edges = [0.0, 0.126, np.nextafter(0.126, 0), MAX_ANGLE, 1 / 256, 3 / 256, 5e-324]
    both = np.concatenate([magnitudes, rng.uniform(0, MAX_ANGLE, 200_000), edges])
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


@pytest.mark.skipif(not elementary.agree(), reason="the C library rounds otherwise")
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
    assert kernel_of(wide).step is cartpole_step_at_any_angle
    assert kernel_of(env).step is (
        cartpole_step if elementary.agree() else cartpole_step_at_any_angle
    )
    monkeypatch.setattr(elementary, "agree", lambda: False)
    assert kernel_of(env).step is cartpole_step_at_any_angle
