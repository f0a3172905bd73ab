"""Which baselines leave the gradient unbiased, by enumeration."""

import pytest
import torch
from torch import nn

from tests.objectives.mdp import BIAS, COVERING, MDP, TOLERANCE, distance
from trl_explore.objectives.baselines import (
    Constant,
    EpisodeMean,
    LeaveOneOut,
    LinearValue,
    StepMean,
)
from trl_explore.objectives.corrections import (
    PerDecision,
    Trajectory,
)
from trl_explore.objectives.episodes import Episodes
from trl_explore.strategies import Softmax


def earlier(mdp, baseline):
    """A baseline that has learned from two trajectories."""
    data = mdp.data(Softmax(), [[0, len(mdp.paths) // 2]] * len(mdp.paths))
    reward, done = data["next", "reward"][:, 0], data["next", "done"][:, 0]
    baseline.step(Episodes(data, reward, done, data["trial"], len(mdp.paths), 1.0))
    return baseline


def critic(mdp):
    baseline = LinearValue()
    n = len(mdp.paths)
    baseline.weight = nn.Parameter(torch.arange(3.0).double().expand(n, 1, 3).clone())
    baseline.bias = nn.Parameter(torch.ones(n, 1).double())
    return baseline


BASELINES = {
    "constant": lambda mdp: Constant(3.0),
    "step_mean": lambda mdp: earlier(mdp, StepMean()),
    "linear_value": critic,
}


@pytest.mark.parametrize("correction", [Trajectory, PerDecision])
@pytest.mark.parametrize("name", ["on_policy", "epsilon_greedy"])
@pytest.mark.parametrize("baseline", BASELINES)
def test_baselines_do_not_bias(mdp, name, baseline, correction):
    made = BASELINES[baseline](mdp)
    strategy = COVERING[name]()
    expected = mdp.expected(strategy, gamma=1.0, baseline=made, correction=correction())
    assert distance(expected, mdp.gradient(1.0)) < TOLERANCE


@pytest.mark.parametrize("name", ["on_policy", "epsilon_greedy"])
def test_leave_one_out_does_not_bias(name):
    mdp = MDP(0, horizon=2)
    expected = mdp.expected(
        COVERING[name](), gamma=1.0, baseline=LeaveOneOut(), correction=PerDecision(), episodes=2
    )
    assert distance(expected, mdp.gradient(1.0)) < TOLERANCE


def test_the_mean_of_the_same_episode_biases(mdp):
    expected = mdp.expected(Softmax(), gamma=1.0, baseline=EpisodeMean())
    assert distance(expected, mdp.gradient(1.0)) > BIAS
