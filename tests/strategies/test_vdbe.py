"""ε that follows the learning progress."""

import math

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase

from trl_explore.strategies import VDBE

POLICY = TensorDictModuleBase()  # for those that do not look at it


def scores(*rows):
    """Data of episodes of (trial, score), two frames each, of which the last is done."""
    done = torch.tensor([[False], [True]] * len(rows))
    reward = torch.tensor([[x] for _, score in rows for x in (0.0, score)])
    after = TensorDict({"done": done, "episode_reward": reward}, [2 * len(rows)])
    trial = torch.tensor([k for k, _ in rows for _ in range(2)])
    return TensorDict({"trial": trial, "next": after}, [2 * len(rows)])


def test_epsilon_follows_the_relative_change_of_the_mean_score():
    strategy = VDBE(initial=1.0, sigma=0.5, delta=0.5, step_size=0.5)
    strategy.bind(POLICY, 3)
    strategy.step(scores((0, 20.0), (1, -8.0)))
    # V = 10 and -4, from 0: Δ = 1, f = (1 - e^-2) / (1 + e^-2)
    f = (1 - math.exp(-2)) / (1 + math.exp(-2))
    np.testing.assert_allclose(strategy.epsilon, [0.5 + f / 2, 0.5 + f / 2, 1.0], rtol=1e-12)
    np.testing.assert_array_equal(strategy.value, [10, -4, 0])
    before = strategy.epsilon.clone()
    strategy.step(scores((0, 10.0), (1, -20.0), (2, 0.0)))
    # V stays 10: Δ = 0. V goes from -4 to -12: Δ = 2/3, Δ/σ = 4/3. No score yet: Δ = 0.
    g = (1 - math.exp(-4 / 3)) / (1 + math.exp(-4 / 3))
    expected = [before[0] / 2, before[1] / 2 + g / 2, 0.5]
    np.testing.assert_allclose(strategy.epsilon, expected, rtol=1e-12)


def test_several_episodes_of_an_iteration_count_with_their_mean():
    several, one = VDBE(), VDBE()
    several.step(scores((0, 10.0), (0, 30.0)))
    one.step(scores((0, 20.0)))
    assert several.epsilon == one.epsilon
    assert several.value == one.value == 2.0


def test_vdbe_is_epsilon_greedy_with_its_epsilon():
    strategy = VDBE(initial=0.5, delta=0.0)
    strategy.bind(POLICY, 2)
    strategy.epsilon.copy_(torch.tensor([0.2, 1.0]))
    probs = strategy.probs(torch.tensor([[0.0, 4.0, -1.0, 4.0]] * 2), torch.tensor([0, 1]))
    expected = torch.tensor([[0.05, 0.45, 0.05, 0.45], [0.25] * 4])
    torch.testing.assert_close(probs, expected)


def test_epsilon_stays_without_data_and_data_need_the_score():
    strategy = VDBE(initial=0.7)
    strategy.step()
    assert strategy.epsilon.tolist() == [0.7]
    data = scores((0, 1.0))
    del data["next", "episode_reward"]
    with pytest.raises(KeyError, match="episode_reward"):
        strategy.step(data)


@pytest.mark.parametrize("name", ["initial", "sigma", "delta", "step_size"])
@pytest.mark.parametrize("value", [-0.1, math.nan, [0.1, 0.2]])
def test_vdbe_refuses(name, value):
    with pytest.raises(ValueError, match=rf"^{name}\b"):
        VDBE(**{name: value})


def test_a_falling_score_changes_as_much_as_a_rising_one():
    """|V' − V| is relative to the larger of the two: from 10 to 5 it is 1/2, as from 5 to 10."""
    strategy = VDBE(initial=1.0, sigma=0.5, delta=1.0, step_size=1.0)
    strategy.bind(POLICY, 1)
    for score, change in ((10.0, 1.0), (5.0, 0.5), (10.0, 0.5)):
        strategy.step(scores((0, score)))
        assert float(strategy.epsilon) == pytest.approx(math.tanh(change))
