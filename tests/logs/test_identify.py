from __future__ import annotations

import re

import pytest

from trl_explore.jobs.files import ResultsError
from trl_explore.logs.identify import Identity, identify, identify_by, labels


@pytest.mark.parametrize(
    ("place", "parts", "environment", "seed"),
    [
        ("runs/CartPole-v1__ppo__1__1700000000", ["runs", "ppo"], "CartPole-v1", 1),
        ("CartPole-v1__dqn_jax__12__1700000000", ["dqn_jax"], "CartPole-v1", 12),
        ("Hopper-v4__sac_continuous_action__5", ["sac_continuous_action"], "Hopper-v4", 5),
        ("PPO_CartPole-v1_3", ["PPO"], "CartPole-v1", 3),
        ("ppo_lr0.1_ALE/Pong-v5", ["ppo_lr0.1_ALE"], "Pong-v5", None),
        ("ppo_ALE-Pong-v5_0", ["ppo"], "ALE-Pong-v5", 0),
        ("logs/ppo/CartPole-v1_2", ["logs", "ppo"], "CartPole-v1", None),
        ("PPO_1", ["PPO"], "", None),
        ("ppo/run_4", ["ppo"], "", None),
        ("ppo/7", ["ppo"], "", None),
        ("ppo/seed_4", ["ppo"], "", 4),
        ("ppo/s4", ["ppo"], "", 4),
        ("ppo-seed-4", ["ppo"], "", 4),
        ("sac_seed10_big", ["sac_big"], "", 10),
        ("lr=0.1,seed=3", ["lr=0.1"], "", 3),
        ("softmax,env.id=CartPole-v1,temperature=0.5,seed=2",
         ["softmax, temperature=0.5"], "CartPole-v1", 2),
        ("layers=[64,64],seed=1", ["layers=[64,64]"], "", 1),
        ("multirun/2024-05-01/10-22-33/0", ["multirun"], "", None),
        ("PPO_CartPole-v1_4a3b2_00001_1_lr=0.001,seed=3_2024-01-01_10-00-00",
         ["PPO, lr=0.001"], "CartPole-v1", 3),
        ("PPO_CartPole-v0_0_seed=1_2019-05-01_10-00-00abcd12", ["PPO"], "CartPole-v0", 1),
        ("PPO-CartPole-v1-lr1e-3-seed-2", ["PPO-lr1e-3"], "CartPole-v1", 2),
        ("sac-MiniGrid-Empty-5x5-v0-seed3", ["sac"], "MiniGrid-Empty-5x5-v0", 3),
        ("dqn_highway-v0", ["dqn"], "highway-v0", None),
        ("ppo_s1_20240101-101010", ["ppo"], "", 1),
        ("ppo, seed: 3", ["ppo"], "", 3),
        ("ppo (seed 3)", ["ppo"], "", 3),
        ("tau2_seeds", ["tau2_seeds"], "", None),
    ],
)  # fmt: skip
def test_folders(place, parts, environment, seed):
    assert identify(place, {}) == Identity(parts, environment, seed)


def test_what_files_say_comes_first():
    facts = {"seed": "4.0", "environment": "Ant-v4", "overrides": "lr=0.1,seed=2"}
    assert identify("ppo_Hopper-v4_3", facts) == Identity(["ppo", "lr=0.1"], "Ant-v4", 4)
    assert identify("x", {"configuration": "a=1, b=2"}) == Identity(["a=1, b=2"])


def test_labels_are_what_differs():
    paths = ["logs/ppo/lr=1,seed=1", "logs/ppo/lr=2,seed=1", "logs/a2c/lr=1,seed=1"]
    assert labels([identify(p, {}) for p in paths]) == ["ppo, lr=1", "ppo, lr=2", "a2c, lr=1"]
    assert labels([identify("logs/ppo/seed1", {}), identify("logs/ppo/seed2", {})]) == ["ppo"] * 2
    assert labels([identify("seed1", {})]) == ["all runs"]


def test_a_pattern():
    pattern = re.compile(r"(?P<configuration>\w+)/.*-x(?P<seed>\d+)")
    assert identify_by(pattern, "ppo/run-x12", {}) == Identity(["ppo"], "", 12)
    with pytest.raises(ResultsError, match="does not occur in 'other'"):
        identify_by(pattern, "other", {})
