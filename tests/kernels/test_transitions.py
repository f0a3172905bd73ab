"""Each kernel against gymnasium, transition by transition."""

from __future__ import annotations

import gymnasium as gym
import numba as nb
import numpy as np
import pytest
from gymnasium.spaces import flatten

from trl_explore.kernels import kernel_of
from trl_explore.kernels.philox import STATE_SIZE, begin
from trl_explore.streams import Stream, generator, key

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


class Compiled:
    """A kernel driven by hand, as the collector drives it."""

    def __init__(self, env: gym.Env) -> None:
        self.kernel = kernel_of(env)
        self.state = np.zeros(self.kernel.state_size)
        self.rng = np.zeros(STATE_SIZE, dtype=np.uint64)

    def begin(self, seed: int, episode: int) -> np.ndarray:
        begin(self.rng, key(seed, Stream.ENVIRONMENT), episode, 0)
        self.kernel.reset(self.kernel.parameters, self.state, self.rng)
        return self.observe()

    def step(self, action: int) -> tuple[np.ndarray, float, bool]:
        reward, terminated = self.kernel.step(self.kernel.parameters, self.state, action, self.rng)
        return self.observe(), reward, bool(terminated)

    def observe(self) -> np.ndarray:
        observation = np.full(self.kernel.n_features, np.nan, dtype=np.float32)
        self.kernel.observe(self.kernel.parameters, self.state, observation)
        return observation


def whole_episodes(env: gym.Env, episodes: int, max_steps: int) -> tuple[int, int]:
    """Step kernel and environment side by side with random actions; count transitions and ends."""
    compiled, space = Compiled(env), env.observation_space
    actions = np.random.default_rng(1)
    transitions = ends = 0
    assert compiled.kernel.n_actions == env.action_space.n
    for episode in range(episodes):
        env.unwrapped.np_random = generator(9, Stream.ENVIRONMENT, 0, episode)
        observation, _ = env.reset()
        np.testing.assert_array_equal(compiled.begin(9, episode), flatten(space, observation))
        for _ in range(max_steps):
            action = int(actions.integers(env.action_space.n))
            observation, reward, terminated, _, _ = env.step(action)
            ours, our_reward, our_terminated = compiled.step(action)
            np.testing.assert_array_equal(ours, flatten(space, observation))
            assert our_reward == reward
            assert our_terminated == terminated
            transitions += 1
            if terminated:
                ends += 1
                break
    return transitions, ends


@pytest.mark.parametrize("kwargs", CARTPOLES)
def test_cartpole_episodes(kwargs):
    env = gym.make("CartPole-v1", disable_env_checker=True, **kwargs).unwrapped
    transitions, ends = whole_episodes(env, episodes=300, max_steps=500)
    assert transitions > 5000
    assert ends == 300


def test_cartpole_in_random_states():
    env = gym.make("CartPole-v1", disable_env_checker=True).unwrapped
    env.reset(seed=0)
    compiled = Compiled(env)
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
    transitions, _ = whole_episodes(env, episodes=100, max_steps=200)
    assert transitions > 2000


@pytest.mark.parametrize("kwargs", LAKES)
def test_frozen_lake_episodes(kwargs):
    env = gym.make("FrozenLake-v1", disable_env_checker=True, **kwargs).unwrapped
    transitions, ends = whole_episodes(env, episodes=400, max_steps=100)
    assert transitions > 1000
    assert ends > 100


def test_initial_states_of_cartpole_are_uniform():
    from scipy.stats import kstest

    env = gym.make("CartPole-v1", disable_env_checker=True)
    compiled = Compiled(env)
    compiled.begin(3, 0)
    states = np.array([[*compiled.begin(3, e)] for e in range(2000)])
    for column in states.T:
        assert kstest(column, "uniform", args=(-0.05, 0.1)).pvalue > 1e-3
    assert np.abs(np.corrcoef(states.T) - np.eye(4)).max() < 0.1


def test_no_kernel_is_a_clear_refusal():
    with pytest.raises(LookupError, match="no kernel is registered for AcrobotEnv"):
        kernel_of(gym.make("Acrobot-v1"))


def test_functions_are_compiled():
    kernel = kernel_of(gym.make("CartPole-v1"))
    assert all(nb.extending.is_jitted(f) for f in (kernel.reset, kernel.step, kernel.observe))
