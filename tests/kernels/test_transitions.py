"""Each kernel against gymnasium, transition by transition."""

from __future__ import annotations

import gymnasium as gym
import numba as nb
import numpy as np
import pytest

from trl_explore.kernels import CompiledEnv, Kernel, check_kernel, kernel_function, kernel_of
from trl_explore.kernels.cartpole import observe, reset

CARTPOLES = [
    {},
    {"sutton_barto_reward": True},
]
LAKES = [
    {"map_name": size, "is_slippery": slippery}
    for size in ("4x4", "8x8")
    for slippery in (True, False)
]
LAKES.append({"desc": ["SFS", "HFG", "FFF"], "success_rate": 0.7, "reward_schedule": (5, -2, -0.1)})


@pytest.mark.parametrize("kwargs", CARTPOLES)
def test_cartpole_episodes(kwargs):
    env = gym.make("CartPole-v1", disable_env_checker=True, **kwargs).unwrapped
    transitions, ends = check_kernel(env, episodes=300, max_steps=500)
    assert transitions > 5000
    assert ends == 300


def test_cartpole_in_random_states():
    env = gym.make("CartPole-v1", disable_env_checker=True).unwrapped
    env.reset(seed=0)
    compiled = CompiledEnv(kernel_of(env), seed=3)
    draws = np.random.default_rng(2)
    terminations = 0
    for _ in range(5000):
        state = draws.uniform([-2.5, -5, -0.22, -5], [2.5, 5, 0.22, 5])
        action = int(draws.integers(2))
        env.state, env.steps_beyond_terminated = state.copy(), None
        observation, reward, terminated, _, _ = env.step(action)
        compiled.state[:] = state
        ours, our_reward, our_terminated = compiled.step(action)
        np.testing.assert_array_equal(ours, observation)
        np.testing.assert_allclose(compiled.state, env.state, rtol=1e-15)
        assert (our_reward, our_terminated) == (reward, terminated)
        terminations += terminated
    assert 500 < terminations < 4500


def test_cartpole_reads_the_instance():
    """A changed constant and integrator of the environment change the kernel."""
    env = gym.make("CartPole-v1", disable_env_checker=True).unwrapped
    env.gravity, env.force_mag, env.kinematics_integrator = 3.7, 4.0, "semi-implicit euler"
    env.theta_threshold_radians = 15 * np.pi / 180
    transitions, _ = check_kernel(env, episodes=100, max_steps=200)
    assert transitions > 2000


@pytest.mark.parametrize("kwargs", LAKES)
def test_frozen_lake_episodes(kwargs):
    env = gym.make("FrozenLake-v1", disable_env_checker=True, **kwargs).unwrapped
    transitions, ends = check_kernel(env, episodes=400, max_steps=100)
    assert transitions > 1000
    assert ends > 100


def test_initial_states_of_cartpole_are_uniform():
    from scipy.stats import kstest

    env = gym.make("CartPole-v1", disable_env_checker=True)
    compiled = CompiledEnv(kernel_of(env), seed=3)
    states = np.array([[*compiled.begin(e)] for e in range(2000)])
    for column in states.T:
        assert kstest(column, "uniform", args=(-0.05, 0.1)).pvalue > 1e-3
    assert np.abs(np.corrcoef(states.T) - np.eye(4)).max() < 0.1


def test_no_kernel_is_a_clear_refusal():
    with pytest.raises(LookupError, match="no kernel is registered for AcrobotEnv"):
        kernel_of(gym.make("Acrobot-v1"))


def test_functions_are_compiled():
    kernel = kernel_of(gym.make("CartPole-v1"))
    assert all(nb.extending.is_jitted(f) for f in (kernel.reset, kernel.step, kernel.observe))


def test_closures_are_refused():
    """What a closure holds would not be seen when compiled code is taken from disk."""
    gain = 2.0

    @kernel_function
    def closing(parameters, state, action, rng):
        return gain, False

    with pytest.raises(ValueError, match="closes over values"):
        Kernel(reset, closing, observe, (), state_size=1, n_features=1, n_actions=2)
    with pytest.raises(ValueError, match="is not compiled"):
        Kernel(reset, lambda *_: (0.0, False), observe, (), 1, 1, 2)


def test_the_fingerprint_knows_every_file(tmp_path, monkeypatch):
    """A changed helper in another file changes the fingerprint."""
    kernel = kernel_of(gym.make("CartPole-v1"))
    before = kernel.digest
    assert kernel_of(gym.make("CartPole-v1")).digest == before
    from trl_explore.kernels import base, philox

    original = base.Path.read_text

    def changed(path, *args, **kwargs):
        text = original(path, *args, **kwargs)
        return text + "# changed" if str(path) == philox.__file__ else text

    monkeypatch.setattr(base.Path, "read_text", changed)
    assert kernel.digest != before


def test_a_faulty_kernel_is_noticed(monkeypatch):
    env = gym.make("CartPole-v1", disable_env_checker=True).unwrapped
    env.gravity = 9.8
    kernel = kernel_of(env)
    env.gravity = 9.9
    from trl_explore.kernels import check

    monkeypatch.setattr(check, "kernel_of", lambda _: kernel)
    with pytest.raises(AssertionError, match="in episode 0 at step"):
        check_kernel(env, episodes=3)
