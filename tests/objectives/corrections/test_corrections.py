"""Corrections by hand: ratios 2 and 1/2, rewards 1, no discount."""

import math
from typing import cast

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential

from trl_explore.collectors import TorchRLCollector
from trl_explore.envs import make_env
from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.corrections import (
    Behaviour,
    NoCorrection,
    PerDecision,
    PerStep,
    Trajectory,
    log_ratio_of,
)
from trl_explore.objectives.episodes import Episodes
from trl_explore.policies import GaussianLinearPolicy, LinearPolicy
from trl_explore.policies.actor import actor_of
from trl_explore.strategies import (
    Argmax,
    EpsilonGreedy,
    EpsilonSoftmax,
    EpsilonUniform,
    EpsilonZGreedy,
    Random,
    Softmax,
    UniformAction,
)
from trl_explore.strategies.schedules import Linear

# Two episodes of one trial: rewards 1, 1, 1 and 1, 1; ratios 2, 1/2, 2 and 1/2, 1/2.
DONE = [False, False, True, False, True]
RATIOS = [2.0, 0.5, 2.0, 0.5, 0.5]


def two_episodes():
    done = torch.tensor(DONE)
    return Episodes(TensorDict({}, [5]), torch.ones(5), done, torch.zeros(5).long(), 1, 1.0)


def advantage(correction, baseline=0.0):
    log_ratio = torch.tensor(RATIOS, dtype=torch.float64).log()
    return correction.advantage(two_episodes(), baseline, log_ratio).tolist()


@pytest.mark.parametrize(
    ("correction", "expected"),
    [
        (NoCorrection(), [3, 2, 1, 2, 1]),
        (PerStep(), [6, 1, 2, 1, 0.5]),
        (PerStep(clip=1.5), [4.5, 1, 1.5, 1, 0.5]),
        # The mean of the ratios is 1.1.
        (PerStep(self_normalize=True), [6 / 1.1, 1 / 1.1, 2 / 1.1, 1 / 1.1, 0.5 / 1.1]),
        # The products are 2 and 1/4.
        (Trajectory(), [6, 4, 2, 0.5, 0.25]),
        (Trajectory(clip=1.0), [3, 2, 1, 0.5, 0.25]),
        (Trajectory(self_normalize=True), [x / 1.125 for x in (6, 4, 2, 0.5, 0.25)]),
        # The products up to each step are 2, 1, 2 and 1/2, 1/4.
        (PerDecision(), [5, 3, 2, 0.75, 0.25]),
        (PerDecision(clip=1.0), [3, 2, 1, 0.75, 0.25]),
        # Means by step: (2 + 1/2) / 2, (1 + 1/4) / 2, (2 + 1/4) / 2, the last of which the
        # second episode did not reach.
        (
            PerDecision(self_normalize=True),
            [
                2 / 1.25 + 1 / 0.625 + 2 / 1.125, 1 / 0.625 + 2 / 1.125, 2 / 1.125,
                0.5 / 1.25 + 0.25 / 0.625, 0.25 / 0.625,
            ],
        ),
    ],
)  # fmt: skip
def test_by_hand(correction, expected):
    assert advantage(correction) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("correction", "weights"),
    [
        (NoCorrection(), [1, 1, 1, 1, 1]),
        (PerStep(), RATIOS),
        (Trajectory(), [2, 2, 2, 0.25, 0.25]),
        (PerDecision(), [2, 1, 2, 0.5, 0.25]),
    ],
)
def test_what_a_baseline_is_multiplied_with(correction, weights):
    without, with_one = advantage(correction), advantage(correction, baseline=1.0)
    assert [a - b for a, b in zip(without, with_one, strict=True)] == pytest.approx(weights)


def test_one_episode_per_update_normalised_is_no_correction():
    done = torch.tensor([False, False, True])
    one = Episodes(TensorDict({}, [3]), torch.ones(3), done, torch.zeros(3).long(), 1, 1.0)
    log_ratio = torch.tensor([2.0, 0.5, 3.0], dtype=torch.float64).log()
    for kind in (Trajectory, PerDecision):
        given = kind(self_normalize=True).advantage(one, 0.0, log_ratio)
        assert given.tolist() == pytest.approx([3, 2, 1])


@pytest.mark.parametrize("correction", [PerStep, Trajectory, PerDecision])
def test_normalised_weights_do_not_vanish_with_the_length_of_an_episode(correction):
    """The smallest double is e^-745: all ratios e^-800 times as large leave the shares alone."""
    small = torch.tensor(RATIOS, dtype=torch.float64).log()
    if correction is PerStep:
        small = small - 800
    else:
        small[[0, 3]] -= 800  # the first step of both episodes: every product has it once
    given = correction(self_normalize=True).advantage(two_episodes(), 0.0, small)
    assert given.tolist() == pytest.approx(advantage(correction(self_normalize=True)))


def test_weights_that_are_all_zero_stay_so():
    never = torch.full((5,), -torch.inf, dtype=torch.float64)
    for correction in (PerStep, Trajectory, PerDecision):
        given = correction(self_normalize=True).advantage(two_episodes(), 0.0, never)
        assert given.tolist() == [0] * 5


def test_importance_weights_need_exact_probabilities():
    for kind in (PerStep, Trajectory, PerDecision):
        kind().actor(None, EpsilonGreedy(0.1))
        with pytest.raises(ValueError, match="EpsilonZGreedy"):
            kind().actor(None, EpsilonZGreedy())


@pytest.mark.parametrize("strategy", [Argmax(), EpsilonGreedy(0.3), None])
def test_the_behaviour_gradient_needs_a_differentiable_strategy(strategy):
    with pytest.raises(ValueError, match="differentiable"):
        Behaviour().actor(None, strategy)
    assert Softmax().differentiable


def gradient_of_behaviour(strategy, policy, env):
    env = make_env(env, trials=2)
    policy = policy(env)
    actor = actor_of(policy)
    loss = ReinforceLoss(actor, correction=Behaviour(), strategy=strategy, functional=False)
    data = TorchRLCollector(env, TensorDictSequential(policy, strategy)).collect().frames
    loss(data)["loss_actor"].backward()
    return [cast(torch.Tensor, parameter.grad) for parameter in policy.parameters()]


@pytest.mark.parametrize(
    "strategy", [Random(), EpsilonSoftmax(1.0), EpsilonSoftmax(Linear(1.0, 0.0, 5))]
)
@pytest.mark.parametrize("env", ["CartPole-v1", "Taxi-v4"])  # without and with masks
def test_the_behaviour_gradient_is_zero_where_nothing_follows_the_policy(strategy, env):
    (gradient,) = gradient_of_behaviour(strategy, LinearPolicy, env)
    assert torch.equal(gradient, torch.zeros_like(gradient))


@pytest.mark.parametrize("kind", [UniformAction, lambda: EpsilonUniform(1.0)])
def test_so_it_is_over_continuous_actions(kind):
    gradients = gradient_of_behaviour(kind(), GaussianLinearPolicy, "Pendulum-v1")
    assert all(torch.equal(gradient, torch.zeros_like(gradient)) for gradient in gradients)


@pytest.mark.parametrize("clip", [0, -1.0, math.nan, "x"])
def test_wrong_clips(clip):
    with pytest.raises(ValueError, match="clip"):
        PerStep(clip=clip)


def test_an_action_that_cannot_have_been_taken():
    with pytest.raises(ValueError, match=r"probability 0.*behaviour policy"):
        log_ratio_of(torch.zeros(2), torch.tensor([0.0, -torch.inf]))
