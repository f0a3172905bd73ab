"""Weights, ε, decay rates and temperatures that are not allowed."""

import math

import numpy as np
import pytest
from tensordict.nn import TensorDictSequential

from trl_explore.collectors import FusedCollector
from trl_explore.envs import make_env
from trl_explore.policies import LinearPolicy
from trl_explore.strategies import (
    DecayingEpsilonGreedy,
    EpsilonGreedy,
    FullMixture,
    Mixture,
    MixtureStrategy,
    Softmax,
)
from trl_explore.strategies.schedules import Linear


@pytest.mark.parametrize("weights", [(0, 0, 0), ([1.0, 0.0], 0, 0)])
def test_weights_that_are_all_zero(weights):
    with pytest.raises(ValueError, match=r"greedy \+ softmax \+ uniform.*positive"):
        FullMixture(*weights)


def test_weights_that_become_zero():
    strategy = FullMixture(greedy=0.0, softmax=Linear(1.0, 0.0, 2), uniform=0.0)
    strategy.step()
    assert strategy.mixture().softmax == 1
    with pytest.raises(ValueError, match=r"0\.0.*iteration 2"):
        strategy.step()


@pytest.mark.parametrize("name", ["greedy", "softmax", "uniform"])
def test_weights_out_of_range(name):
    for value in (-0.1, math.nan, Linear(1.0, -0.1, 5)):
        with pytest.raises(ValueError, match=f"^{name}.*>= 0"):
            FullMixture(**{name: value})


@pytest.mark.parametrize("epsilon", [-0.1, 1.1, math.nan, "0.3", [0.1, 1.1], Linear(0, 2, 9)])
def test_epsilon_out_of_range(epsilon):
    with pytest.raises(ValueError, match=r"epsilon.*\[0, 1\]"):
        EpsilonGreedy(epsilon)


@pytest.mark.parametrize("decay", [-0.1, 1.1, math.nan, "fast"])
def test_decay_out_of_range(decay):
    with pytest.raises(ValueError, match=r"decay.*\[0, 1\]"):
        DecayingEpsilonGreedy(decay)


@pytest.mark.parametrize("temperature", [0, -1.0, math.nan, math.inf, [1.0, 0.0]])
def test_temperature_out_of_range(temperature):
    with pytest.raises(ValueError, match=r"temperature.*> 0"):
        Softmax(temperature)


class Stated(MixtureStrategy):
    """A strategy that states what it is given, from iteration 1 on."""

    def __init__(self, point: Mixture) -> None:
        super().__init__()
        self.point = point

    def mixture(self) -> Mixture:
        return self.point if self.iteration else Mixture(uniform=1.0)


@pytest.mark.parametrize(
    ("point", "message"),
    [
        (Mixture(softmax=1.0, temperature=np.ones(2)), "temperature.*2.*5"),
        (Mixture(softmax=0.5, uniform=0.1), "sum to 1.*0.0.*0.5.*0.1"),
        (Mixture(softmax=1.5, uniform=-0.5), ">= 0.*sum to 1.*1.5.*-0.5"),
        (Mixture(greedy=np.full(5, 0.5), uniform=np.linspace(0.5, 0.6, 5)), "sum to 1"),
        (Mixture(softmax=math.nan), "sum to 1"),
    ],
)
def test_what_is_no_mixture_is_refused_whenever_it_comes(point, message):
    """Compiled code must not read beside an array, and a weight must not get lost."""
    env = make_env("CartPole-v1", trials=5)
    strategy = Stated(point)
    collector = FusedCollector(env, TensorDictSequential(LinearPolicy(env), strategy))
    collector.collect()
    strategy.step()
    with pytest.raises(ValueError, match=message):
        collector.collect()


@pytest.mark.parametrize(
    "weights",
    [
        {"greedy": 0.5, "uniform": 0.51},
        {"greedy": 1.5, "uniform": -0.5},
        {"greedy": np.array([0.5, 0.5]), "uniform": np.array([0.5, 0.52])},
        {"greedy": np.array([0.5, 1.5]), "uniform": np.array([0.5, -0.5])},
    ],
)
def test_weights_are_a_distribution_for_every_trial(weights):
    class Own(MixtureStrategy):
        def mixture(self):
            return Mixture(**weights)

    with pytest.raises(ValueError, match="sum to 1"):
        Own().checked_mixture(2)
