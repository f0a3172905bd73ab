from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any, cast

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torchrl.envs import EnvBase
from torchrl.envs.utils import check_env_specs
from torchrl.modules import RandomPolicy

from trl_explore.checks import first_line
from trl_explore.collectors import FusedCollector, TorchRLCollector
from trl_explore.envs import LaneVectorEnv, lane_env, make_env
from trl_explore.numerics.streams import Stream, generator
from trl_explore.policies import LinearPolicy
from trl_explore.strategies import Random, Softmax

IDS = {  # id -> number of features, number of actions
    "CartPole-v1": (4, 2),
    "Acrobot-v1": (6, 3),
    "MountainCar-v0": (2, 3),
    "FrozenLake-v1": (16, 4),
    "CliffWalking-v1": (48, 4),
    "Taxi-v4": (500, 6),
}
DISCRETE = ("FrozenLake-v1", "CliffWalking-v1", "Taxi-v4")


def reference(id: str, trial: int, episode: int, seed: int = 0, **kwargs) -> tuple[gym.Env, ...]:
    """gymnasium's own environment at the start of an episode, and its first observation."""
    env = gym.make(id, **kwargs)
    if id in DISCRETE:
        env = gym.wrappers.FlattenObservation(env)
    env.unwrapped.np_random = generator(seed, Stream.ENVIRONMENT, trial, episode)
    return env, env.reset()[0]


def restart(env: EnvBase, mask: list[bool]) -> torch.Tensor:
    """Reset the lanes of the mask; the observations of all [trials, n_features]."""
    mask = torch.tensor(mask)
    reset = TensorDict({"_reset": mask.unsqueeze(-1)}, mask.shape)
    return env.reset(reset)["observation"]


@pytest.mark.parametrize("id", IDS)
def test_specs(id):
    n_features, n_actions = IDS[id]
    env = make_env(id, trials=3, max_steps=30)
    check_env_specs(env, break_when_any_done="both")
    assert env.batch_size == (3,)
    assert env.action_spec.space.n == n_actions
    observation = env.reset()["observation"]
    assert observation.shape == (3, n_features)
    assert env.observation_spec["observation"].shape == (3, n_features)


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("first_trial", [0, 7])
def test_every_transition_is_gymnasiums(id, first_trial):
    """Reward, flags and observations of two episodes, with lanes that finish at other times."""
    trials, limit = 3, 25
    env = make_env(id, trials, max_steps=limit, seed=11, first_trial=first_trial)
    actions = np.random.default_rng(3).integers(IDS[id][1], size=(2, limit, trials))
    for episode in range(2):
        td = env.reset()
        others = [
            reference(id, first_trial + k, episode, seed=11, max_episode_steps=limit)
            for k in range(trials)
        ]
        for k, (_, observation) in enumerate(others):
            np.testing.assert_array_equal(td["observation"][k].numpy(), observation)
        done, score = [False] * trials, np.zeros(trials)
        for step in range(limit):
            td["action"] = torch.from_numpy(actions[episode, step])
            td = env.step(td)
            after = td["next"]
            for k, (other, _) in enumerate(others):
                if done[k]:
                    continue
                expected, reward, terminated, truncated, _ = other.step(actions[episode, step, k])
                score[k] += reward
                done[k] = terminated or truncated
                np.testing.assert_array_equal(after["observation"][k].numpy(), expected)
                assert after["reward"][k].item() == reward
                assert after["terminated"][k].item() == terminated
                assert after["truncated"][k].item() == truncated
                assert after["done"][k].item() == done[k]
                assert after["step_count"][k].item() == step + 1
                assert after["episode_reward"][k].item() == score[k]
            td = env._step_mdp(td)
        assert all(done)


class Counting(gym.Env):
    """Counts its own steps; ends after as many as the next number of ``lengths`` says."""

    observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = spaces.Discrete(2)
    lengths: Iterator[int] = iter(())

    def __init__(self) -> None:
        self.length = next(Counting.lengths, 1)
        self.steps = self.resets = 0
        self.ended = True

    def reset(self, *, seed=None, options=None):
        self.resets, self.ended, self.age = self.resets + 1, False, 0
        return np.array([self.resets, 0], np.float32), {}

    def step(self, action):
        assert not self.ended, "a finished environment was stepped"
        self.steps += 1
        self.age += 1
        self.ended = self.age == self.length
        return np.array([self.resets, self.age], np.float32), 1.0, self.ended, False, {}


@pytest.fixture
def counting():
    """Lane k ends after k + 1 steps; the second copy is only asked whether there are masks."""
    gym.register("Counting-v0", Counting, max_episode_steps=9)
    Counting.lengths = iter((1, 9, 2, 3))
    yield "Counting-v0"
    gym.registry.pop("Counting-v0")


def test_only_unfinished_lanes_are_stepped(counting):
    lanes = LaneVectorEnv(counting, 3)
    lanes.reset()
    seen = [lanes.step(np.zeros(3, np.int64)) for _ in range(4)]
    assert [env.unwrapped.steps for env in lanes.envs] == [1, 2, 3]
    observations, rewards, terminated, _, _ = map(np.stack, zip(*seen, strict=True))
    # A finished lane keeps its last observation and gets no reward.
    assert observations[..., 1].tolist() == [[1, 1, 1], [1, 2, 2], [1, 2, 3], [1, 2, 3]]
    assert rewards.tolist() == [[1, 1, 1], [0, 1, 1], [0, 0, 1], [0, 0, 0]]
    assert terminated.tolist() == [
        [True, False, False],
        [True, True, False],
        [True, True, True],
        [True, True, True],
    ]
    assert not lanes.running.any()


def test_what_it_returns_is_not_overwritten_later(counting):
    lanes = LaneVectorEnv(counting, 3)
    first, _ = lanes.reset()
    second = lanes.step(np.zeros(3, np.int64))
    lanes.step(np.zeros(3, np.int64))
    assert first[:, 1].tolist() == [0, 0, 0]
    assert second[0][:, 1].tolist() == [1, 1, 1]
    assert second[2].tolist() == [True, False, False]


def test_a_partial_reset_leaves_the_other_lanes_alone(counting):
    lanes = LaneVectorEnv(counting, 3)
    lanes.reset()
    for _ in range(2):
        lanes.step(np.zeros(3, np.int64))
    observation, _ = lanes.reset(options={"reset_mask": np.array([True, False, False])})
    assert observation.tolist() == [[2, 0], [1, 2], [1, 2]]
    assert [env.unwrapped.resets for env in lanes.envs] == [2, 1, 1]
    assert lanes.running.tolist() == [True, False, True]
    _, rewards, terminated, _, _ = lanes.step(np.zeros(3, np.int64))
    assert rewards.tolist() == [1, 0, 1]
    assert terminated.tolist() == [True, True, True]


def test_an_episode_depends_on_its_number_and_nothing_else():
    env = make_env(trials=3, seed=4)
    first = env.reset()["observation"].clone()
    second = env.reset()["observation"].clone()
    assert (first != second).any(-1).all()
    lane_env(env).reseed(4)
    for _ in range(5):  # lane 1 alone; the others keep their places
        restart(env, [False, True, False])
    assert torch.equal(restart(env, [True, False, False])[0], first[0])
    assert torch.equal(restart(env, [True, False, True])[0], second[0])
    expected = reference("CartPole-v1", 1, 5, seed=4)[1]
    np.testing.assert_array_equal(restart(env, [False, True, False])[1].numpy(), expected)


def test_each_lane_of_each_seed_has_its_own_stream():
    starts = [
        tuple(row)
        for seed in range(4)
        for row in make_env(trials=6, seed=seed).reset()["observation"].tolist()
    ]
    assert len(set(starts)) == len(starts)


def test_lane_k_is_first_trial_k():
    together = make_env(trials=5, seed=2).reset()["observation"]
    for k in range(5):
        alone = make_env(trials=1, seed=2, first_trial=k).reset()["observation"]
        assert torch.equal(alone[0], together[k])


def test_frozen_lake_draws_at_every_step_from_its_own_stream():
    """The lanes slip independently although they take the same actions."""
    env = make_env("FrozenLake-v1", trials=20)
    places = env.rollout(6, RandomPolicy(env.action_spec), break_when_any_done=False)
    assert len(places["next", "observation"][:, -1].unique(dim=0)) > 1


def test_a_seed_at_reset_is_the_seed_of_the_job():
    lanes, other = LaneVectorEnv("CartPole-v1", 2, seed=0), LaneVectorEnv("CartPole-v1", 2, seed=9)
    lanes.reset()
    np.testing.assert_array_equal(lanes.reset(seed=9)[0], other.reset()[0])
    np.testing.assert_array_equal(lanes.reset()[0], other.reset()[0])
    env = make_env(trials=2, seed=0)
    env.set_seed(9)
    assert lane_env(env).seed == 9


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


def test_the_pole_that_falls_is_terminated():
    env = make_env(trials=1)
    data = env.rollout(50, lambda td: td.set("action", torch.tensor([1])))
    last = data[0, -1]["next"]
    assert last["terminated"].item()
    assert not last["truncated"].item()
    assert abs(last["observation"][2]) > 12 * np.pi / 180


def test_constructor_arguments_are_passed_on():
    env = make_env("FrozenLake-v1", trials=2, kwargs={"is_slippery": False})
    td = env.reset().set("action", torch.tensor([2, 2]))  # right, and nothing slips
    assert env.step(td)["next", "observation"].argmax(-1).tolist() == [1, 1]


@pytest.mark.parametrize("id", ["Acrobot-v1", "MountainCar-v0", *DISCRETE])
def test_agents_train_on_it(id, train):
    before = train(Softmax(), id=id, max_steps=15, max_iterations=1)
    after = train(Softmax(), id=id, max_steps=15, max_iterations=3, score_threshold=1e9)
    assert after.trials.status.tolist() == ["capped", "capped"]
    weights = [job.optimizer.parameters[0] for job in (before, after)]
    assert weights[0].shape == (2, IDS[id][1], IDS[id][0])
    assert weights[1].isfinite().all()


class Odd(Counting):
    """A kind of environment that is not supported; attributes are set by the test."""


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
    monkeypatch.setitem(gym.registry, "Free-v0", EnvSpec("Free-v0", Counting))
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


def test_actions_outside_of_the_bounds_are_clipped_for_the_environment_only():
    """gymnasium's car charges for the force that is asked for, so that it must not see −7."""
    id = "MountainCarContinuous-v0"  # forces within [-1, 1]
    env = make_env(id, trials=3, seed=5)
    td = env.reset()
    assert env.action_spec.shape == (3, 1)
    drawn = torch.tensor([[-7.0], [0.5], [1.5]])
    td = env.step(td.set("action", drawn))
    assert torch.equal(td["action"], drawn)
    rewards = td["next", "reward"].flatten().tolist()
    assert rewards == pytest.approx([-0.1, -0.025, -0.1])
    for k, seen in enumerate([-1.0, 0.5, 1.0]):
        other, _ = reference(id, k, 0, seed=5)
        expected, *_ = other.step(np.array([seen], np.float32))
        np.testing.assert_array_equal(td["next", "observation"][k].numpy(), expected)


def test_specs_of_continuous_actions():
    check_env_specs(make_env("Pendulum-v1", trials=3, max_steps=5), break_when_any_done="both")


class Masked(gym.Env):
    """Walks right on five tiles. Tile k allows actions 0 to k; the last one, where it ends, none.

    With ``broken`` at least 0, that tile gives what is named.
    """

    observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = spaces.Discrete(4)

    def __init__(self, broken: int = -1, what: str = "mask") -> None:
        self.broken, self.what = broken, what

    def _signals(self):
        broken = self.what if self.tile == self.broken else ""
        mask = np.arange(4, dtype=np.int8) <= self.tile
        if self.tile == 4 or broken == "mask":
            mask[:] = 0
        info = {} if broken == "info" else {"action_mask": mask[:2] if broken == "shape" else mask}
        seen = [self.tile, np.nan if broken == "observation" else 0]
        return np.array(seen, np.float32), (np.inf if broken == "reward" else 1.0), info

    def reset(self, *, seed=None, options=None):
        self.tile = 0
        observation, _, info = self._signals()
        return observation, info

    def step(self, action):
        assert action <= self.tile, "a forbidden action was taken"
        self.tile += 1
        observation, reward, info = self._signals()
        return observation, reward, self.tile == 4, False, info


@pytest.fixture
def masked(monkeypatch):
    spec = EnvSpec("Masked-v0", Masked, max_episode_steps=3)
    monkeypatch.setitem(gym.registry, "Masked-v0", spec)
    return "Masked-v0"


def test_the_mask_is_an_observation(masked):
    env = make_env(masked, trials=2, max_steps=9)
    check_env_specs(make_env("Taxi-v4", trials=2, max_steps=4), break_when_any_done="both")
    td = env.reset()
    assert td["action_mask"].dtype == torch.bool
    masks = [td["action_mask"][0].tolist()]
    for _ in range(5):
        td = env.step(td.set("action", torch.tensor([0, 0])))
        masks.append(td["next", "action_mask"][1].tolist())
        td = env._step_mdp(td)
    walk = [[a <= tile for a in range(4)] for tile in range(4)]
    # Nobody acts on the last tile: what forbids everything is taken for what allows everything.
    assert masks == [*walk, [True] * 4, [True] * 4]


def test_no_mask_where_there_is_none():
    td = make_env(trials=2).rollout(2)
    assert "action_mask" not in td.keys(include_nested=True)


@pytest.mark.parametrize("strategy", [Softmax, Random])
def test_strategies_obey_the_mask(strategy, masked):
    """Else the environment itself would object."""
    env = make_env(masked, trials=20, max_steps=9)
    both = TensorDictSequential(LinearPolicy(env), strategy())
    data = TorchRLCollector(env, both).collect().frames
    assert data["action_mask"].shape == (80, 4)
    assert data["action_mask"].gather(-1, data["action"].unsqueeze(-1)).all()
    assert data["action"].unique().tolist() == [0, 1, 2, 3]
    assert not data["action_log_prob"][data["observation"][:, 0] == 0].any()  # no choice there


def test_the_mask_of_taxi_is_gymnasiums():
    env = make_env("Taxi-v4", trials=3, max_steps=30)
    both = TensorDictSequential(LinearPolicy(env), Softmax())
    data = TorchRLCollector(env, both).collect().frames
    taxi = gym.make("Taxi-v4").unwrapped
    for state, mask in zip(data["observation"].argmax(-1), data["action_mask"], strict=True):
        assert mask.tolist() == taxi.action_mask(int(state)).astype(bool).tolist()


def test_the_loss_obeys_the_mask(train, masked):
    """Where one action alone is allowed there is nothing to learn; elsewhere there is."""
    untrained = LinearPolicy(make_env(masked, 2)).weight
    for steps in (1, 3):
        job = train(Softmax(), id=masked, max_steps=steps, max_iterations=3, score_threshold=1e9)
        assert torch.equal(job.optimizer.parameters[0], untrained) == (steps == 1)


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ((2, "observation"), r"'Masked-v0'.*observation\[1\].*nan.*episode 0.*trial 7"),
        ((2, "reward"), "'Masked-v0'.*reward.*inf.*episode 0.*trial 7"),
        ((2, "mask"), "'Masked-v0'.*action mask.*episode 0"),
        ((2, "info"), r"info\['action_mask'\].*4 actions.*None"),
        ((2, "shape"), r"info\['action_mask'\].*4 actions.*array"),
        ((0, "observation"), r"'Masked-v0'.*observation\[1\].*nan.*episode 0.*trial 7"),
    ],
)
def test_what_is_not_finite_is_refused_where_it_appears(masked, broken, message):
    arguments = {"broken": broken[0], "what": broken[1]}
    lanes = LaneVectorEnv(masked, 2, 9, kwargs=arguments, first_trial=7)
    episodes = (lanes.reset() if t in (0, 3) else lanes.step(np.zeros(2, int)) for t in range(6))
    with pytest.raises(ValueError, match=message):
        list(episodes)


def test_an_action_that_is_not_finite_is_refused():
    lanes = LaneVectorEnv("Pendulum-v1", 2)
    lanes.reset()
    with pytest.raises(ValueError, match=r"'Pendulum-v1'.*action \[nan\].*episode 0.*trial 1"):
        lanes.step(np.array([[0.0], [np.nan]], np.float32))


def test_lane_env_refuses_other_environments():
    with pytest.raises(ValueError, match=r"lanes.*trl_explore\.envs\.make_env"):
        lane_env(cast(Any, object()))


def test_first_line():
    assert first_line(ValueError("\none\ntwo")) == "one"
    assert first_line(KeyError()) == "KeyError"
