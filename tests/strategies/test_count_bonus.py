"""The bonus of what has been tried less often."""

import math

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.data import OneHot

from trl_explore.collectors import FusedCollector, TorchRLCollector
from trl_explore.envs import make_env
from trl_explore.numerics.streams import Stream, generator
from trl_explore.policies import TabularPolicy
from trl_explore.strategies import CountBonus
from trl_explore.strategies.schedules import Linear

POLICY = TensorDictModuleBase()  # for those that do not look at it


def visits(n_actions=2, **entries):
    """States of three features in two trials, with equal preferences."""
    observation = torch.tensor([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [-3.0, 1.0, 0.5]])
    trial = torch.tensor([0, 1, 1])
    data = {"observation": observation, "trial": trial, "logits": torch.zeros(3, n_actions)}
    return TensorDict({**data, **entries}, [3])


def bonus(strategy):
    data = visits()
    return strategy.preferences(data, data["logits"]).tolist()


def test_bonus_by_hand():
    strategy = CountBonus(beta=6.0, bits=20)
    strategy.bind(POLICY, 2, seed=1)
    assert bonus(strategy) == [[6.0, 6.0]] * 3
    strategy.step(visits(action=torch.tensor([0, 1, 1])))
    once = pytest.approx(6 / math.sqrt(2))
    assert bonus(strategy) == [[once, 6.0], [6.0, once], [6.0, once]]
    for _ in range(2):
        strategy.step(visits(action=torch.tensor([0, 1, 0]))[1:])
    thrice, twice = pytest.approx(6 / math.sqrt(4)), pytest.approx(6 / math.sqrt(3))
    assert bonus(strategy) == [[once, 6.0], [6.0, thrice], [twice, once]]


def test_several_visits_of_one_iteration_all_count():
    strategy = CountBonus(beta=1.0)
    state = {"observation": torch.ones(8, 3), "action": torch.tensor([0] * 5 + [1] * 3)}
    data = TensorDict({**state, "logits": torch.zeros(8, 2)}, [8])
    strategy.preferences(data, data["logits"])
    strategy.step(data)
    expected = torch.tensor([[1 / math.sqrt(6), 1 / 2]] * 8)
    torch.testing.assert_close(strategy.preferences(data, data["logits"]), expected)


def test_the_hash_is_the_sign_of_a_gaussian_projection_of_the_trials_own():
    strategy = CountBonus(bits=5)
    strategy.bind(POLICY, 2, seed=4, first_trial=7)
    data = visits(action=torch.zeros(3, dtype=torch.int64))
    strategy.preferences(data, data["logits"])
    strategy.step(data)
    counts = strategy.visits.counts
    for k, x in ((0, [1, 2, 3]), (1, [1, 2, 3]), (1, [-3, 1, 0.5])):
        drawn = generator(4, Stream.STRATEGY, 7 + k)
        matrix = drawn.standard_normal((5, 3), np.float32)
        code = sum(2**b for b in range(5) if matrix[b] @ np.array(x) > 0)
        assert counts[k, code, 0] >= 1
    assert counts.sum() == 3


def test_every_one_hot_state_has_a_cell():
    strategy = CountBonus(bits=20)
    state = TensorDict({"observation": torch.eye(64), "logits": torch.zeros(64, 4)}, [64])
    state["action"] = torch.arange(64) % 4
    strategy.preferences(state, state["logits"])
    strategy.step(state)
    seen = strategy.preferences(state, state["logits"]) < 1
    assert torch.equal(seen, torch.nn.functional.one_hot(state["action"], 4).bool())


def test_one_hot_actions_are_counted():
    strategy = CountBonus(spec=OneHot(2))
    strategy.bind(POLICY, 2)
    assert bonus(strategy) == [[1.0, 1.0]] * 3
    strategy.step(visits(action=torch.tensor([[1, 0], [0, 1], [0, 1]]).bool()))
    once = pytest.approx(1 / math.sqrt(2))
    assert bonus(strategy) == [[once, 1.0], [1.0, once], [1.0, once]]


def test_counts_with_temperature_zero_take_the_least_tried():
    strategy = CountBonus(temperature=0.0)
    strategy.bind(POLICY, 2)
    strategy(visits())
    strategy.step(visits(action=torch.tensor([0, 1, 1])))
    for _ in range(5):
        assert strategy(visits())["action"].tolist() == [1, 0, 0]


def test_beta_per_trial_and_by_schedule():
    strategy = CountBonus(beta=[1.0, 3.0])
    strategy.bind(POLICY, 2)
    assert bonus(strategy) == [[1.0, 1.0], [3.0, 3.0], [3.0, 3.0]]
    strategy = CountBonus(beta=Linear(4.0, 0.0, iterations=2))
    strategy.bind(POLICY, 2)
    strategy.step()
    assert bonus(strategy) == [[2.0, 2.0]] * 3
    with pytest.raises(ValueError, match="3 trials"):
        CountBonus(beta=[1.0, 3.0]).bind(POLICY, 3)


def test_under_a_tabular_policy_every_state_is_a_cell():
    policy = TabularPolicy(make_env("FrozenLake8x8-v1", trials=2))
    strategy = CountBonus(beta=1.0, bits=1)
    strategy.bind(policy, 2)
    state = TensorDict({"observation": torch.eye(64), "logits": torch.zeros(64, 4)}, [64])
    state["action"] = torch.arange(64) % 4
    strategy.preferences(state, state["logits"])
    strategy.step(state)
    seen = strategy.preferences(state, state["logits"]) < 1
    assert torch.equal(seen, torch.nn.functional.one_hot(state["action"], 4).bool())


@pytest.mark.parametrize("options", [{}, {"beta": [0.5, 1.0, 4.0]}, {"temperature": 0.0}])
@pytest.mark.parametrize("id", ["FrozenLake-v1", "trl_explore/RiverSwim-v0"])
def test_both_collectors_count_alike(id, options):
    """The fused collector takes the bonus as a part of the table."""

    def play(kind):
        env = make_env(id, trials=3, seed=5)
        policy = TabularPolicy(env, init="normal")
        strategy = CountBonus(**options)
        collector = kind(env, TensorDictSequential(policy, strategy))
        found = []
        for _ in range(6):
            rollout = collector.collect()
            strategy.step(rollout.frames)
            found.append(rollout.frames.clone())
        return found

    for fused, torchrl in zip(play(FusedCollector), play(TorchRLCollector), strict=True):
        assert torch.equal(fused["action"], torchrl["action"])
        torch.testing.assert_close(fused["action_log_prob"], torchrl["action_log_prob"])


def test_who_changes_the_bonus_is_not_compiled_as_its_parent():
    class Squared(CountBonus):
        def preferences(self, tensordict, logits):
            return super().preferences(tensordict, logits) ** 2

    env = make_env("FrozenLake-v1", trials=1)
    for strategy, compiled in ((CountBonus(), True), (Squared(), False)):
        strategy.bind(TabularPolicy(env), 1)
        assert strategy.compilable == compiled
