"""The loss, its gradient and the corrections with continuous actions, against torch and scipy."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import stats
from torch.distributions import Independent, Normal
from torchrl.modules import IndependentNormal, ProbabilisticActor

from tests.continuous import BOTH, collector_of
from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.corrections import Behaviour, PerStep
from trl_explore.policies.actor import actor_of
from trl_explore.strategies import (
    EpsilonMean,
    EpsilonUniform,
    Gaussian,
    MeanAction,
)


def loss_of(policy, **wanted):
    return ReinforceLoss(actor_of(policy), gamma=0.9, weight=2.0, trials=3, **wanted)


def returns_of(data):
    """G of 30 frames for each of three trials, by the definition."""
    reward = data["next", "reward"].reshape(3, 30)
    powers = 0.9 ** torch.arange(30.0)
    return torch.stack([(reward[:, t:] * powers[: 30 - t]).sum(1) for t in range(30)], 1)


@pytest.mark.parametrize("functional", [False, True])
@pytest.mark.parametrize("policy", BOTH)
@pytest.mark.parametrize("dependent", [False, True])
def test_loss_and_gradient_are_those_of_torchs_distributions(policy, functional, dependent):
    collector = collector_of(Gaussian(), policy, state_dependent_scale=dependent)
    built, data = collector.policy[0], collector.collect().frames
    parameters = list(built.parameters())
    out = loss_of(built, functional=functional)(data)
    ours = torch.autograd.grad(out["loss_actor"], parameters)
    written = built(data.clone())
    log_prob = Independent(Normal(written["loc"], written["scale"]), 1).log_prob(data["action"])
    expected = -2 * (returns_of(data) * log_prob.reshape(3, 30)).sum(1)
    torch.testing.assert_close(out["trial_loss"], expected.detach(), rtol=1e-4, atol=1e-3)
    theirs = torch.autograd.grad(expected.sum(), parameters)
    for a, b in zip(ours, theirs, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=2e-3)


def test_loss_under_an_actor_of_torchrl():
    collector = collector_of(Gaussian())
    built, data = collector.policy[0], collector.collect().frames
    theirs = ProbabilisticActor(
        built, in_keys=["loc", "scale"], distribution_class=IndependentNormal
    )
    a = loss_of(built, functional=False)(data)["trial_loss"]
    b = ReinforceLoss(theirs, gamma=0.9, weight=2.0, trials=3, functional=False)(data)["trial_loss"]
    torch.testing.assert_close(a, b)


def test_gradient_of_the_behaviour_policy():
    """log mu at temperature 2 is the log-density of a Gaussian twice as wide."""
    strategy = Gaussian(temperature=2.0)
    collector = collector_of(strategy)
    built, data = collector.policy[0], collector.collect().frames
    loss = loss_of(built, functional=False, correction=Behaviour(), strategy=strategy)
    ours = torch.autograd.grad(loss(data)["loss_actor"], list(built.parameters()))
    written = built(data.clone())
    wide = Independent(Normal(written["loc"], 2 * written["scale"]), 1)
    expected = -2 * (returns_of(data) * wide.log_prob(data["action"]).reshape(3, 30)).sum()
    theirs = torch.autograd.grad(expected, list(built.parameters()))
    for a, b in zip(ours, theirs, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=2e-3)


def test_ratios_are_those_of_scipy():
    strategy = EpsilonUniform(0.3)
    collector = collector_of(strategy)
    built, data = collector.policy[0], collector.collect().frames
    loss = loss_of(built, functional=False, correction=PerStep(), strategy=strategy)
    written = built(data.clone())
    action, loc, scale = (
        x.detach().double().numpy() for x in (data["action"], written["loc"], written["scale"])
    )
    pi = stats.norm.pdf(action, loc, scale)[:, 0]
    mu = 0.7 * pi + 0.3 * stats.uniform.pdf(action, -2, 4)[:, 0]
    expected = returns_of(data).reshape(-1).numpy() * pi / mu
    np.testing.assert_allclose(loss.advantage(data), expected, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("strategy", [MeanAction(), EpsilonMean()])
@pytest.mark.parametrize("correction", [PerStep(), Behaviour()])
def test_corrections_that_do_not_exist(strategy, correction):
    built = collector_of(strategy).policy[0]
    with pytest.raises(ValueError, match=f"{type(strategy).__name__}"):
        loss_of(built, correction=correction, strategy=strategy)
