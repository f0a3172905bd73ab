"""The intrinsic reward: what it adds, and that the score knows nothing of it."""

from __future__ import annotations

import math

import pytest
import torch
from hydra import compose, initialize_config_dir
from tensordict import TensorDict

from trl_explore.config import CONF, ConfigError
from trl_explore.config.building import build_trainer
from trl_explore.training.intrinsic import CountReward


def frames(states, actions, trials):
    """Frames of one-hot states with the reward −1."""
    observation = torch.eye(3)[torch.tensor(states)]
    reward = {"reward": -torch.ones(len(states), 1), "episode_reward": torch.zeros(len(states), 1)}
    entries = {"observation": observation, "action": torch.tensor(actions)}
    return TensorDict({**entries, "trial": torch.tensor(trials), "next": reward}, [len(states)])


def added(intrinsic, data):
    intrinsic(data)
    assert not data["next", "episode_reward"].any()
    return [reward + 1 for reward in data["next", "reward"].squeeze(-1).tolist()]


def test_by_hand():
    """β / √N with the frames of the iteration counted, per trial, state and action."""
    intrinsic = CountReward(3.0, trials=2, n_actions=2, one_hot=True)
    first = added(intrinsic, frames([0, 0, 0, 2, 0], [1, 1, 0, 1, 1], [0, 0, 0, 0, 1]))
    assert first == pytest.approx([3 / math.sqrt(2), 3 / math.sqrt(2), 3, 3, 3])
    second = added(intrinsic, frames([0, 2, 0], [1, 0, 1], [0, 0, 1]))
    assert second == pytest.approx([3 / math.sqrt(3), 3, 3 / math.sqrt(2)])


def test_its_state_is_saved():
    one, two = (CountReward(3.0, trials=2, n_actions=2, one_hot=True) for _ in range(2))
    added(one, frames([0, 1], [1, 1], [0, 1]))
    two.load_state_dict(one.state_dict())
    assert added(two, frames([0, 0], [1, 1], [0, 1])) == pytest.approx([3 / math.sqrt(2), 3])


def test_each_trial_counts_with_a_hash_of_its_own():
    """A trial is the same in any company: its counts depend on its own frames and index alone."""
    draws = torch.Generator().manual_seed(0)
    observation = torch.randn(40, 4, generator=draws)

    def rewards(trials, first_trial, rows):
        intrinsic = CountReward(1.0, trials, 2, seed=3, first_trial=first_trial)
        n = len(observation)
        data = TensorDict({
            "observation": observation, "action": torch.zeros(n).long(),
            "trial": torch.arange(n) % trials, "next": {"reward": torch.zeros(n, 1)},
        }, [n])  # fmt: skip
        data = data[data["trial"] == rows] if trials > 1 else data[1::2].clone()
        intrinsic(data)
        return data.get(("next", "reward"))

    torch.testing.assert_close(rewards(2, 0, 1), rewards(1, 1, 0), rtol=0, atol=0)


def trained(*overrides):
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("train", ["env=river_swim", "policy=tabular", "trials=3", *overrides])
    trainer = build_trainer(config)
    for _ in range(5):
        trainer._iterate(0.0)
    return trainer


def test_the_score_is_the_environments():
    """The first episodes are the same; then the weights differ, and the scores stay small."""
    without, with_it = trained(), trained("intrinsic_reward=100")
    scores = [t.trials.episodes()["score"] for t in (without, with_it)]
    assert (scores[0][:3] == scores[1][:3]).all()
    assert scores[1].max() <= 20
    weights = [t.optimizer.parameters[0].detach() for t in (without, with_it)]
    assert not torch.equal(*weights)


def test_what_it_refuses():
    for value in (-1, float("nan")):
        with pytest.raises(ValueError, match="intrinsic_reward"):
            CountReward(value, trials=1, n_actions=2)
    with pytest.raises(ConfigError, match=r"^intrinsic_reward.*got -1"):
        trained("intrinsic_reward=-1")
    with pytest.raises(ConfigError, match=r"^intrinsic_reward counts discrete actions.*continuous"):
        trained("intrinsic_reward=1", "env=pendulum", "policy=gaussian_linear",
                "strategy=gaussian")  # fmt: skip
