"""Each kernel against gymnasium, transition by transition."""

from __future__ import annotations

import sys
from dataclasses import replace

import gymnasium as gym
import numba as nb
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from trl_explore.envs.kernels import (
    CompiledEnv,
    Kernel,
    check_kernel,
    kernel_function,
    kernel_of,
    tabular,
)
from trl_explore.envs.kernels.classic_control import cartpole_observe as observe
from trl_explore.envs.kernels.classic_control import cartpole_reset as reset
from trl_explore.envs.kernels.kernel import _BUILDERS
from trl_explore.numerics.compiled import philox
from trl_explore.numerics.compiled.elementary import cos32, sin32
from trl_explore.numerics.streams import Stream, generator

LAKE = {"desc": ["SFS", "HFG", "FFF"], "success_rate": 0.7, "reward_schedule": (5, -2, -0.1)}
CASES = [  # id, arguments, attributes, steps of an episode, how many of 200 terminate at least
    ("CartPole-v1", {}, {}, 500, 200),
    ("CartPole-v1", {"sutton_barto_reward": True}, {}, 500, 200),
    ("CartPole-v1", {}, {"theta_threshold_radians": 15 * np.pi / 180, "length": 0.7}, 500, 200),
    ("CartPole-v1", {}, {"theta_threshold_radians": 1.2}, 500, 200),
    (
        "CartPole-v1",
        {},
        {"gravity": 3.7, "force_mag": 4.0, "kinematics_integrator": "semi-implicit euler"},
        500,
        150,
    ),
    ("MountainCar-v0", {}, {}, 100, 0),
    ("MountainCar-v0", {"goal_velocity": 0.02}, {"force": 0.004, "max_speed": 0.1}, 200, 5),
    ("Acrobot-v1", {}, {}, 100, 0),
    ("Acrobot-v1", {}, {"book_or_nips": "nips", "torque_noise_max": 0.5, "dt": 0.1}, 100, 0),
    ("Acrobot-v1", {}, {"LINK_MASS_1": 0.6, "LINK_COM_POS_2": 0.3, "LINK_LENGTH_1": 1.3}, 100, 0),
    *[
        ("FrozenLake-v1", {"map_name": size, "is_slippery": slippery}, {}, 100, 100)
        for size in ("4x4", "8x8")
        for slippery in (True, False)
    ],
    ("FrozenLake-v1", LAKE, {}, 100, 150),
    ("CliffWalking-v1", {}, {}, 100, 0),
    ("CliffWalkingSlippery-v1", {}, {}, 100, 0),
    ("Taxi-v4", {}, {}, 100, 0),
    ("Taxi-v4", {"is_rainy": True}, {}, 100, 0),
]


def make(id: str, arguments=None, attributes=None) -> gym.Env:
    env = gym.make(id, disable_env_checker=True, **(arguments or {})).unwrapped
    for name, value in (attributes or {}).items():
        assert hasattr(env, name)
        setattr(env, name, value)
    return env


@pytest.mark.parametrize(("id", "arguments", "attributes", "steps", "least"), CASES)
def test_every_transition_is_gymnasiums(id, arguments, attributes, steps, least):
    """Observations, masks, rewards and terminations, bit for bit, in 200 episodes."""
    env = make(id, arguments, attributes)
    transitions, ends = check_kernel(env, episodes=200, max_steps=steps)
    assert transitions > 500
    assert ends >= least


def test_every_kernel_is_among_the_cases():
    covered = {type(make(id, arguments)) for id, arguments, *_ in CASES}
    assert {env for env in _BUILDERS if env.__module__.startswith("gymnasium")} == covered


@pytest.mark.parametrize(
    ("id", "arguments", "ends"),
    [  # how many of the pairs of state and action end the episode
        ("FrozenLake-v1", {"is_slippery": False}, None),
        # Down from above, right from the cliff, and right and down against the walls in the goal.
        ("CliffWalking-v1", {}, 1 + 1 + 2),
        # The passenger is put down where it wants to go.
        ("Taxi-v4", {}, 4),
        ("Taxi-v4", {"is_rainy": True}, None),
    ],
)
def test_every_state_and_action_of_a_table(id, arguments, ends):
    """Also those that random episodes do not come to."""
    env = make(id, arguments)
    compiled = CompiledEnv(kernel_of(env))
    n_states, n_actions = int(env.observation_space.n), int(env.action_space.n)
    found = 0
    for state in range(n_states):
        for action in range(n_actions):
            episode = state * n_actions + action
            env.np_random = generator(0, Stream.ENVIRONMENT, 0, episode)
            env.reset()
            compiled.begin(episode)
            env.s = compiled.state[0] = state
            after, reward, terminated, _, info = env.step(action)
            ours, our_reward, our_terminated = compiled.step(action)
            assert_array_equal(ours, np.eye(n_states)[after])
            assert (our_reward, our_terminated) == (reward, terminated)
            if "action_mask" in info:
                assert_array_equal(compiled.mask(), info["action_mask"])
            found += terminated
    assert found > 0 if ends is None else found == ends


@pytest.mark.parametrize("id", ["Acrobot-v1", "MountainCar-v0"])
def test_whole_episodes(id):
    """Up to the time limit: a double pendulum forgives no rounding."""
    transitions, _ = check_kernel(make(id), episodes=20, max_steps=500, seed=1)
    assert transitions > 9000


RANDOM_STATES = {  # id: bounds of random states, and the share of steps from there that terminate
    "CartPole-v1": ([2.5, 5, 0.22, 5], 0.1, 0.9),
    "MountainCar-v0": ([1.3, 0.08], 0.1, 0.9),
    "Acrobot-v1": ([4, 4, 15, 35], 0.1, 0.9),
}


@pytest.mark.parametrize("id", RANDOM_STATES)
def test_in_random_states(id):
    """Also where no episode leads: beyond walls, goals and the largest speeds."""
    bounds, low, high = RANDOM_STATES[id]
    env = make(id)
    env.reset(seed=0)
    compiled = CompiledEnv(kernel_of(env), seed=3)
    draws = np.random.default_rng(2)
    n, terminations = 3000, 0
    for _ in range(n):
        state = draws.uniform(-np.array(bounds), bounds)
        action = int(draws.integers(env.action_space.n))
        env.state, env.steps_beyond_terminated = state.copy(), None
        observation, reward, terminated, _, _ = env.step(action)
        compiled.state[:] = 0
        compiled.state[: len(state)] = state
        ours, our_reward, our_terminated = compiled.step(action)
        assert_array_equal(ours, observation)
        assert_allclose(compiled.state[: len(state)], env.state, rtol=1e-15)
        assert (our_reward, our_terminated) == (reward, terminated)
        terminations += terminated
    assert low * n < terminations < high * n


@pytest.mark.parametrize(("ours", "theirs"), [(cos32, np.cos), (sin32, np.sin)])
def test_float32_functions_are_numpys(ours, theirs):
    angles = np.random.default_rng(0).uniform(-np.pi / 4, np.pi / 4, 20_000).astype(np.float32)
    values = np.array([ours(angle) for angle in angles])  # numba returns float32 as Python's float
    assert_array_equal(values, theirs(angles))
    assert_allclose(values, theirs(angles.astype(np.float64)), rtol=1.2e-7)


def test_a_table_of_ones_own():
    """Two states: from 0 action 1 leads to 1 for a reward of 2, where everything ends."""
    table = {
        0: {0: [(0.5, 0, -1.0, False), (0.5, 1, 0.0, False)], 1: [(1.0, 1, 2.0, True)]},
        1: {0: [(1.0, 1, 0.0, True)], 1: [(1.0, 1, 0.0, True)]},
    }
    masks = np.array([[True, True], [True, False]])
    env = CompiledEnv(tabular(table, np.array([1.0, 0.0]), masks))
    assert env.begin(0).tolist() == [1, 0]
    assert env.mask().tolist() == [True, True]
    observation, reward, terminated = env.step(1)
    assert (observation.tolist(), reward, terminated) == ([0, 1], 2.0, True)
    assert env.mask().tolist() == [True, False]
    moved = 0
    for episode in range(2000):
        env.begin(episode)
        _, reward, terminated = env.step(0)
        assert not terminated
        moved += reward == 0
    assert 900 < moved < 1100


def test_what_a_kernel_does_not_serve_is_a_clear_refusal():
    with pytest.raises(LookupError, match="fickle_passenger=True"):
        kernel_of(gym.make("Taxi-v4", fickle_passenger=True))


def test_initial_states_of_cartpole_are_uniform():
    from scipy.stats import kstest

    env = gym.make("CartPole-v1", disable_env_checker=True)
    compiled = CompiledEnv(kernel_of(env), seed=3)
    states = np.array([[*compiled.begin(e)] for e in range(2000)])
    for column in states.T:
        assert kstest(column, "uniform", args=(-0.05, 0.1)).pvalue > 1e-3
    assert np.abs(np.corrcoef(states.T) - np.eye(4)).max() < 0.1


def test_no_kernel_is_a_clear_refusal():
    with pytest.raises(LookupError, match=r"kernel.*PendulumEnv"):
        kernel_of(gym.make("Pendulum-v1"))


def test_functions_are_compiled():
    kernel = kernel_of(gym.make("CartPole-v1"))
    assert all(nb.extending.is_jitted(f) for f in (kernel.reset, kernel.step, kernel.observe))


def test_closures_are_refused():
    """What a closure holds would not be seen when compiled code is taken from disk."""
    gain = 2.0

    @kernel_function
    def closing(parameters, state, action, rng):
        return gain, False

    with pytest.raises(ValueError, match="closes over"):
        Kernel(reset, closing, observe, (), state_size=1, n_features=1, n_actions=2)
    with pytest.raises(ValueError, match="compiled"):
        Kernel(reset, lambda *_: (0.0, False), observe, (), 1, 1, 2)


def test_the_fingerprint_knows_every_file(tmp_path, monkeypatch):
    """A changed helper in another file changes the fingerprint."""
    kernel = kernel_of(gym.make("CartPole-v1"))
    before = kernel.digest
    assert kernel_of(gym.make("CartPole-v1")).digest == before
    from trl_explore.envs.kernels import kernel as base
    from trl_explore.numerics.compiled import philox

    original = base.Path.read_text

    def changed(path, *args, **kwargs):
        text = original(path, *args, **kwargs)
        return text + "# changed" if str(path) == philox.__file__ else text

    monkeypatch.setattr(base.Path, "read_text", changed)
    assert kernel.digest != before


GRAVITY, TABLE = 9.8, np.arange(3.0)


@kernel_function
def falling(parameters, state, action, rng):
    return GRAVITY * TABLE[0] * philox.to_unit(rng[0]), state[0] < philox.STATE_SIZE


def test_the_fingerprint_knows_constants_and_modules(monkeypatch):
    """Numba makes both part of the code, wherever they come from."""
    kernel = Kernel(reset, falling, observe, (), state_size=1, n_features=1, n_actions=2)
    digests = [kernel.digest]
    for place, name, value in (
        (sys.modules[__name__], "GRAVITY", 9.81),
        (sys.modules[__name__], "TABLE", np.arange(1.0, 4.0)),
        (philox, "STATE_SIZE", 12),
        (philox, "to_unit", falling),
    ):
        monkeypatch.setattr(place, name, value)
        digests.append(kernel.digest)
    assert len(set(digests)) == 5


def test_a_faulty_kernel_is_noticed(monkeypatch):
    env = gym.make("CartPole-v1", disable_env_checker=True).unwrapped
    env.gravity = 9.8
    kernel = kernel_of(env)
    env.gravity = 9.9
    from trl_explore.envs.kernels import kernel as module

    monkeypatch.setattr(module, "kernel_of", lambda _: kernel)
    with pytest.raises(AssertionError, match="in episode 0 at step"):
        check_kernel(env, episodes=3)


def test_a_faulty_mask_is_noticed(monkeypatch):
    env = make("Taxi-v4")
    faulty = kernel_of(env)
    faulty.parameters[5][:, 0] = True
    from trl_explore.envs.kernels import kernel as module

    monkeypatch.setattr(module, "kernel_of", lambda _: faulty)
    with pytest.raises(AssertionError, match="in episode"):
        check_kernel(env, episodes=3)
    monkeypatch.setattr(module, "kernel_of", lambda _: replace(faulty, mask=None))
    with pytest.raises(AssertionError, match="mask None, not"):
        check_kernel(env, episodes=1)
