"""``AsIf`` has the bias of another strategy, by enumeration."""

import pytest
import torch

from tests.objectives.mdp import (
    ACTIONS,
    COVERING,
    HORIZON,
    MDP,
    OFF_POLICY,
    STATES,
    TOLERANCE,
    distance,
)
from trl_explore.objectives.corrections import (
    AsIf,
    PerStep,
)
from trl_explore.strategies import DecayingEpsilonGreedy, EpsilonGreedy, Softmax


def off_policy_terms(mdp, acting):
    """d_μ(t, s) and Q_μ(t, s, a) of the strategy that acts, by enumeration."""
    visits, value = torch.zeros(2, HORIZON, STATES, ACTIONS, dtype=torch.float64)
    for p, (_, path) in zip(mdp.chances(acting), mdp.paths, strict=True):
        for t, (s, a, _) in enumerate(path):
            visits[t, s, a] += p
            value[t, s, a] += p * sum(r for _, _, r in path[t:])
    return visits.sum(-1, keepdim=True), value / visits


@pytest.mark.parametrize("acting", ["on_policy", "hot", "random"])
@pytest.mark.parametrize("other", OFF_POLICY)
def test_as_if_has_the_bias_of_the_other_strategy_in_every_state(mdp, acting, other):
    """Σ_s d_μ(s) Σ_a μ'(a|s) ∇log π(a|s) Q_μ(s, a): only the action's weight is that of μ'."""
    acts, assumed = COVERING[acting](), OFF_POLICY[other]()
    expected = mdp.expected(acts, gamma=1.0, correction=AsIf(OFF_POLICY[other]()))
    if other == "decaying":  # the assumed strategy follows the iteration of the one that acts
        assumed = DecayingEpsilonGreedy(0.9)
    weight = mdp.weight.clone().requires_grad_()
    visits, q = off_policy_terms(mdp, acts)
    total = (visits * mdp.probs(mdp.weight, assumed) * mdp.probs(weight).log() * q).nansum()
    assert distance(expected, torch.autograd.grad(total, weight)[0]) < TOLERANCE


@pytest.mark.parametrize("other", OFF_POLICY)
def test_in_episodes_of_one_step_as_if_is_the_other_agent_uncorrected(other):
    mdp = MDP(5, horizon=1)
    assumed = OFF_POLICY[other]()
    acts = Softmax()
    acts.iteration = assumed.iteration
    expected = mdp.expected(acts, gamma=1.0, correction=AsIf(assumed))
    assert distance(expected, mdp.expected(OFF_POLICY[other](), gamma=1.0)) < TOLERANCE


def test_as_if_the_policy_is_the_ratio_and_as_if_itself_is_no_correction(mdp):
    acts = EpsilonGreedy(0.4)
    ratio = mdp.expected(acts, gamma=1.0, correction=PerStep())
    assert distance(mdp.expected(acts, gamma=1.0, correction=AsIf(Softmax())), ratio) < TOLERANCE
    plain = mdp.expected(acts, gamma=1.0)
    own = mdp.expected(acts, gamma=1.0, correction=AsIf(EpsilonGreedy(0.4)))
    assert distance(own, plain) < TOLERANCE
