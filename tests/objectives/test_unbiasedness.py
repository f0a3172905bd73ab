"""Which corrections are unbiased: the expected gradient, by enumeration, against the true one."""

import pytest
import torch

from tests.objectives.mdp import (
    ACTIONS,
    BIAS,
    COVERING,
    HORIZON,
    MDP,
    OFF_POLICY,
    STATES,
    TOLERANCE,
    distance,
)
from trl_explore.objectives.corrections import (
    Behaviour,
    NoCorrection,
    PerDecision,
    PerStep,
    Trajectory,
)
from trl_explore.strategies import Argmax, EpsilonGreedy, Softmax


def test_the_trajectories_are_all(mdp):
    for strategy in COVERING.values():
        assert float(mdp.chances(strategy()).sum()) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("correction", [Trajectory, PerDecision])
@pytest.mark.parametrize("name", COVERING)
def test_weights_of_whole_histories_are_unbiased(mdp, name, correction):
    strategy = COVERING[name]()
    expected = mdp.expected(strategy, gamma=1.0, correction=correction())
    assert distance(expected, mdp.gradient(1.0)) < TOLERANCE
    expected = mdp.expected(strategy, gamma=0.7, correction=correction(), discount_steps=True)
    assert distance(expected, mdp.gradient(0.7)) < TOLERANCE


@pytest.mark.parametrize("correction", [NoCorrection, PerStep, Trajectory, PerDecision, Behaviour])
def test_on_policy_everything_is_unbiased(mdp, correction):
    assert (
        distance(mdp.expected(Softmax(), gamma=1.0, correction=correction()), mdp.gradient(1.0))
        < TOLERANCE
    )


@pytest.mark.parametrize("name", ["on_policy", "cold", "hot"])
def test_the_behaviour_gradient_is_that_of_the_behaviours_return(mdp, name):
    strategy = COVERING[name]()
    options = {"correction": Behaviour()}
    expected = mdp.expected(strategy, gamma=1.0, **options)
    assert distance(expected, mdp.gradient(1.0, strategy)) < TOLERANCE
    expected = mdp.expected(strategy, gamma=0.7, discount_steps=True, **options)
    assert distance(expected, mdp.gradient(0.7, strategy)) < TOLERANCE


@pytest.mark.parametrize("name", OFF_POLICY)
def test_without_correction_off_policy_data_are_biased(mdp, name):
    expected = mdp.expected(OFF_POLICY[name](), gamma=1.0)
    assert distance(expected, mdp.gradient(1.0)) > BIAS


@pytest.mark.parametrize("name", OFF_POLICY)
def test_the_ratio_of_the_action_alone_is_biased_beyond_one_step(mdp, name):
    strategy = OFF_POLICY[name]()
    assert distance(mdp.expected(strategy, gamma=1.0, correction=PerStep()), mdp.gradient(1)) > BIAS


@pytest.mark.parametrize("name", COVERING)
def test_and_unbiased_in_episodes_of_one_step(name):
    mdp = MDP(5, horizon=1)
    expected = mdp.expected(COVERING[name](), gamma=1.0, correction=PerStep())
    assert distance(expected, mdp.gradient(1.0)) < TOLERANCE


def test_the_ratio_gives_the_off_policy_gradient(mdp):
    """Σ_s d_μ(s) Σ_a ∇π(a|s) Q_μ(s, a), with d_μ and Q_μ from the enumeration."""
    strategy = EpsilonGreedy(0.4)
    weight = mdp.weight.clone().requires_grad_()
    pi, chance = mdp.probs(weight), mdp.chances(strategy)
    visits, value = torch.zeros(2, HORIZON, STATES, ACTIONS, dtype=torch.float64)
    for p, (_, path) in zip(chance, mdp.paths, strict=True):
        for t, (s, a, _) in enumerate(path):
            visits[t, s, a] += p
            value[t, s, a] += p * sum(r for _, _, r in path[t:])
    q = value / visits
    total = (visits.sum(-1, keepdim=True) * pi * q).nansum()
    expected = mdp.expected(strategy, gamma=1.0, correction=PerStep())
    assert distance(expected, torch.autograd.grad(total, weight)[0]) < TOLERANCE


@pytest.mark.parametrize("correction", [PerStep, Trajectory, PerDecision])
def test_no_weight_repairs_argmax(mdp, correction):
    expected = mdp.expected(Argmax(), gamma=1.0, correction=correction())
    assert distance(expected, mdp.gradient(1.0)) > BIAS


@pytest.mark.parametrize("options", [{"clip": 0.7}, {"self_normalize": True}])
@pytest.mark.parametrize("correction", [Trajectory, PerDecision])
def test_clipping_and_normalising_bias(mdp, correction, options):
    expected = mdp.expected(EpsilonGreedy(0.3), gamma=1.0, correction=correction(**options))
    assert distance(expected, mdp.gradient(1.0)) > BIAS


def test_a_discount_without_its_factor_is_biased(mdp):
    expected = mdp.expected(Softmax(), gamma=0.7)
    assert distance(expected, mdp.gradient(0.7)) > BIAS
    assert distance(expected, mdp.gradient(1.0)) > BIAS


def test_normalised_advantages_are_biased(mdp):
    expected = mdp.expected(Softmax(), gamma=1.0, normalize_advantage=True)
    assert distance(expected, mdp.gradient(1.0)) > BIAS


def test_the_entropy_bonus_adds_the_gradient_of_the_entropy(mdp):
    """Σ_τ P(τ) Σ_t ∇H(π(·|s_t)), by enumeration."""
    with_bonus = mdp.expected(Softmax(), gamma=1.0, entropy_coeff=0.5)
    weight = mdp.weight.clone().requires_grad_()
    pi = mdp.probs(weight)
    entropy = -(pi * pi.log()).sum(-1)
    total = sum(
        p * entropy[s]
        for p, (_, path) in zip(mdp.chances(Softmax()), mdp.paths, strict=True)
        for s, _, _ in path
    )
    bonus = torch.autograd.grad(total, weight)[0]
    assert distance(with_bonus, mdp.gradient(1.0) + 0.5 * bonus) < TOLERANCE
