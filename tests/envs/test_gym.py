"""How an environment is built: its arguments, attributes and time limit, and what is refused."""

from __future__ import annotations

import sys

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from tensordict.nn import TensorDictSequential

from trl_explore.collectors import FusedCollector, TorchRLCollector
from trl_explore.envs import lane_env, make_env
from trl_explore.policies import LinearPolicy
from trl_explore.strategies import Random


class Odd(gym.Env):
    """A kind of environment that is not supported; attributes are set by the test."""

    observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        return np.zeros(2, np.float32), {}


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"observation_space": spaces.Text(5)}, "Text.*Box, Discrete.*Dict or Tuple"),
        ({"observation_space": spaces.Dict(a=spaces.Sequence(spaces.Discrete(2)))}, "Sequence"),
        ({"observation_space": spaces.Discrete(10**12)}, "1000000000000 numbers.*10000000"),
        ({"observation_space": spaces.Box(0, 1, (0,))}, "0 numbers"),
        ({"observation_space": None}, "observation space None"),
        ({"action_space": spaces.Box(0, 9, (2,), np.int64)}, "Box of floats.*wrapper"),
        ({"action_space": spaces.Dict(a=spaces.Discrete(2))}, "Dict.*Discrete.*wrapper"),
        ({"action_space": spaces.MultiDiscrete([100, 100])}, "10000 combinations.*1000.*wrapper"),
    ],
)
def test_kinds_not_supported(attributes, message, monkeypatch):
    for name, value in attributes.items():
        monkeypatch.setattr(Odd, name, value)
    monkeypatch.setitem(gym.registry, "Odd-v0", EnvSpec("Odd-v0", Odd, max_episode_steps=5))
    with pytest.raises(ValueError, match=message) as raised:
        make_env("Odd-v0")
    assert "'Odd-v0'" in str(raised.value)


def test_an_environment_without_a_limit_needs_max_steps(monkeypatch):
    monkeypatch.setitem(gym.registry, "Free-v0", EnvSpec("Free-v0", Odd))
    with pytest.raises(ValueError, match=r"'Free-v0'.*max_steps"):
        make_env("Free-v0")
    assert lane_env(make_env("Free-v0", max_steps=4)).max_steps == 4


@pytest.mark.parametrize(
    ("id", "arguments", "message"),
    [
        ("NoSuch-v0", {}, "'NoSuch-v0'"),
        ("ALE/Pong-v5", {}, "'ALE/Pong-v5'"),
        ("no_module:NoSuch-v0", {}, "'no_module:NoSuch-v0'"),
        ("not an id", {}, "'not an id'"),
        (
            "CartPole-v1",
            {"kwargs": {"nonsense": 1}},
            "'CartPole-v1'.*nonsense",
        ),
        ("FrozenLake-v1", {"kwargs": {"map_name": "no"}}, "'FrozenLake-v1'.*'no'"),
        (
            "CartPole-v1",
            {"attributes": {"mass": 1.0}},
            "'CartPole-v1'.*'mass'",
        ),
        (
            "CartPole-v1",
            {"attributes": {"reset": 1.0}},
            "'CartPole-v1'.*'reset'",
        ),
        (
            "CartPole-v1",
            {"attributes": {"gravity": "low"}},
            "gravity.*'CartPole-v1'.*finite.*'low'",
        ),
        (
            "CartPole-v1",
            {"attributes": {"kinematics_integrator": 3}},
            "kinematics_integrator.*'CartPole-v1'.*text.*3",
        ),
        (
            "Taxi-v4",
            {"attributes": {"fickle_passenger": 1}},
            "fickle_passenger.*'Taxi-v4'.*true.*false.*1",
        ),
        ("CartPole-v1", {"workers": 0}, "workers.*>= 1.*0"),
        ("CartPole-v1", {"max_steps": 0}, "max_steps.*>= 1.*0"),
        ("CartPole-v1", {"max_steps": -3}, "max_steps.*>= 1.*-3"),
        ("CartPole-v1", {"max_steps": 1.5}, "max_steps.*>= 1.*1.5"),
        ("CartPole-v1", {"trials": 0}, "num_envs.*>= 1.*0"),
        ("CartPole-v1", {"seed": -1}, "seed.*>= 0.*-1"),
    ],
)
def test_wrong_input_is_one_clear_line(id, arguments, message):
    with pytest.raises(ValueError, match=message) as raised:
        make_env(id, **arguments)
    assert "\n" not in str(raised.value)


def test_a_missing_package_names_the_extra(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("gymnasium.envs.box2d")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "Box2D", None)
    with pytest.raises(
        ValueError,
        match=r"'LunarLander-v3'.*pip install 'trl_explore\[box2d\]'$",
    ):
        make_env("LunarLander-v3")


def test_an_attribute_is_obeyed_by_gymnasium_and_kernel():
    """The pole that may lean by 15 degrees falls later, and in both collectors alike."""
    limit = 15 * np.pi / 180
    arguments = {"trials": 10, "attributes": {"theta_threshold_radians": limit}}
    data = {}
    for collector in (FusedCollector, TorchRLCollector):
        env = make_env(**arguments)
        policy = TensorDictSequential(LinearPolicy(env), Random())
        data[collector] = collector(env, policy).collect().frames
    angle = data[TorchRLCollector]["observation"][:, 2].abs()
    assert 12 * np.pi / 180 < angle.max() <= limit
    for key in ("observation", "action", ("next", "terminated")):
        assert torch.equal(data[FusedCollector][key], data[TorchRLCollector][key])


def test_an_integer_attribute_stays_one():
    env = make_env("MountainCar-v0", attributes={"goal_velocity": 0.0, "force": 1})
    car = lane_env(env).envs[0].unwrapped
    assert (type(car.goal_velocity), type(car.force)) == (int, float)


@pytest.mark.parametrize("max_steps", [1, 3])
def test_max_steps_truncates(max_steps):
    env = make_env(trials=2, max_steps=max_steps)
    assert lane_env(env).max_steps == max_steps
    data = env.rollout(10, break_when_any_done=False, break_when_all_done=True)
    assert data.shape == (2, max_steps)
    last = data[:, -1]["next"]
    assert last["truncated"].all()
    assert last["done"].all()
    assert not last["terminated"].any()
    assert not data[:, :-1]["next", "done"].any()


def test_max_steps_extends_the_limit_that_gymnasium_registers():
    env = make_env("MountainCar-v0", max_steps=230)  # registered with 200
    data = env.rollout(300, lambda td: td.set("action", torch.tensor([1])))  # never climbs
    assert data.shape == (1, 230)
    assert data[0, -1]["next", "truncated"].item()


def test_the_registered_limit_is_the_default():
    assert lane_env(make_env("CartPole-v1")).max_steps == 500
    assert lane_env(make_env("Acrobot-v1")).max_steps == 500
    assert lane_env(make_env("FrozenLake-v1")).max_steps == 100


def test_constructor_arguments_are_passed_on():
    env = make_env("FrozenLake-v1", trials=2, kwargs={"is_slippery": False})
    td = env.reset().set("action", torch.tensor([2, 2]))  # right, and nothing slips
    assert env.step(td)["next", "observation"].argmax(-1).tolist() == [1, 1]


def test_the_whole_message_of_a_constructor_is_one_line(monkeypatch):
    def build(self):
        raise ValueError("render_mode must be\none of rgb_array")

    monkeypatch.setattr(Odd, "__init__", build, raising=False)
    monkeypatch.setitem(gym.registry, "Odd-v0", EnvSpec("Odd-v0", Odd, max_episode_steps=5))
    with pytest.raises(ValueError, match="ValueError: render_mode must be one of rgb_array"):
        make_env("Odd-v0")
