"""Action masks, which an environment returns in ``info``."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from tensordict.nn import TensorDictSequential
from torchrl.envs.utils import check_env_specs

from trl_explore.collectors import TorchRLCollector
from trl_explore.envs import LaneVectorEnv, make_env
from trl_explore.policies import LinearPolicy
from trl_explore.strategies import Random, Softmax


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


class LateMask(gym.Env):
    """A mask that comes with steps, and not with the reset."""

    observation_space, action_space = Masked.observation_space, spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        return np.zeros(2, np.float32), {}

    def step(self, action):
        assert action == 0
        return np.zeros(2, np.float32), 1.0, False, False, {"action_mask": [1, 0]}


def test_a_mask_that_comes_with_steps_only_is_obeyed(monkeypatch):
    spec = EnvSpec("Late-v0", LateMask, max_episode_steps=5)
    monkeypatch.setitem(gym.registry, "Late-v0", spec)
    lanes = LaneVectorEnv("Late-v0", 1)
    assert lanes.has_masks
    for _ in range(2):
        assert lanes.reset()[1]["action_mask"].tolist() == [[True, True]]
        assert lanes.step(np.zeros(1, int))[-1]["action_mask"].tolist() == [[True, False]]
