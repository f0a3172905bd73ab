"""The expected gradient of the loss, by enumeration, against the true one of a small MDP.

Every trajectory τ of a random MDP with three states, two actions and three steps is listed, with
its probability under the behaviour policy. The expected gradient Σ_τ P_μ(τ) ∇L(τ) is then exact,
and so is the gradient of the expected return, by automatic differentiation of Σ_τ P(τ) R(τ).
"""

import itertools

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.baselines import (
    Constant,
    EpisodeMean,
    LeaveOneOut,
    LinearValue,
    StepMean,
)
from trl_explore.objectives.corrections import (
    AsIf,
    Behaviour,
    NoCorrection,
    PerDecision,
    PerStep,
    Trajectory,
)
from trl_explore.objectives.episodes import Episodes
from trl_explore.policies.actor import SoftmaxActor
from trl_explore.strategies import Argmax, DecayingEpsilonGreedy, EpsilonGreedy, Random, Softmax

STATES, ACTIONS, HORIZON = 3, 2, 3
TOLERANCE, BIAS = 1e-9, 1e-3


class MDP:
    """A random MDP: an episode ends after ``horizon`` steps, or before, with a probability."""

    def __init__(self, seed, horizon=HORIZON):
        rng = np.random.default_rng(seed)
        self.horizon = horizon
        self.start = rng.dirichlet(np.ones(STATES))
        # The last successor is the end of the episode.
        self.move = rng.dirichlet(np.ones(STATES + 1), (STATES, ACTIONS))
        self.reward = rng.normal(1.0, 2.0, (STATES, ACTIONS))
        self.weight = torch.from_numpy(rng.normal(size=(ACTIONS, STATES)))
        self.paths = [p for s in range(STATES) for p in self._from(s, self.start[s], 1)]

    def _from(self, state, chance, depth):
        for action in range(ACTIONS):
            frame = (state, action, self.reward[state, action])
            ends = self.move[state, action, STATES] if depth < self.horizon else 1.0
            yield chance * ends, [frame]
            if depth < self.horizon:
                for after in range(STATES):
                    step = chance * self.move[state, action, after]
                    for p, rest in self._from(after, step, depth + 1):
                        yield p, [frame, *rest]

    def policy(self):
        linear = nn.Linear(STATES, ACTIONS, bias=False).double()
        linear.weight = nn.Parameter(self.weight.clone())
        return SoftmaxActor(TensorDictModule(linear, ["observation"], ["logits"])), linear.weight

    def probs(self, weight, strategy=None):
        """π, or μ, of every state and action [STATES, ACTIONS]."""
        logits = weight.t()
        return logits.softmax(-1) if strategy is None else strategy.probs(logits)

    def gradient(self, gamma, strategy=None):
        """∇ Σ_τ P(τ) Σ_t γ^t r_t, of π or of μ."""
        weight = self.weight.clone().requires_grad_()
        probs = self.probs(weight, strategy)
        total = torch.zeros((), dtype=torch.float64)
        for dynamics, path in self.paths:
            score = sum(gamma**t * r for t, (_, _, r) in enumerate(path))
            chance = torch.stack([probs[s, a] for s, a, _ in path]).prod()
            total = total + dynamics * score * chance
        return torch.autograd.grad(total, weight)[0]

    def chances(self, strategy):
        """P_μ(τ) of every trajectory."""
        mu = self.probs(self.weight, strategy)
        return torch.stack(
            [p * torch.stack([mu[s, a] for s, a, _ in path]).prod() for p, path in self.paths]
        )

    def data(self, strategy, groups):
        """The frames of groups of trajectories, one trial for each group."""
        mu = self.probs(self.weight, strategy)
        frames = [
            (k, s, a, r, t == len(self.paths[i][1]) - 1, t)
            for k, group in enumerate(groups)
            for i in group
            for t, (s, a, r) in enumerate(self.paths[i][1])
        ]
        trial, state, action, reward, done, step = map(torch.tensor, zip(*frames, strict=True))
        return TensorDict(
            {
                "trial": trial,
                "observation": nn.functional.one_hot(state, STATES).double(),
                "action": action,
                "action_log_prob": mu[state, action].log(),
                "step": step,
                "next": {
                    "reward": reward.double().unsqueeze(-1),
                    "done": done.unsqueeze(-1),
                },
            },
            [len(frames)],
        )

    def expected(self, strategy, *, episodes=1, **options):
        """Σ_τ P_μ(τ) · (−∇L(τ)) over all trajectories, or all tuples of them."""
        chance = self.chances(strategy)
        possible = [i for i in range(len(self.paths)) if chance[i] > 0]
        groups = list(itertools.product(possible, repeat=episodes))
        actor, weight = self.policy()
        loss = ReinforceLoss(
            actor, weight=1.0, reduction="none", trials=len(groups), strategy=strategy,
            functional=False, **options,
        )  # fmt: skip
        chances = torch.stack([torch.stack([chance[i] for i in g]).prod() for g in groups])
        value = (loss(self.data(strategy, groups))["loss_actor"] * chances).sum()
        return -torch.autograd.grad(value, weight)[0] / episodes


@pytest.fixture(params=range(3), scope="module")
def mdp(request):
    return MDP(request.param)


def decayed():
    strategy = DecayingEpsilonGreedy(0.9)
    for _ in range(7):
        strategy.step()
    return strategy


COVERING = {
    "random": Random,
    "epsilon_greedy": lambda: EpsilonGreedy(0.3),
    "decaying": decayed,
    "cold": lambda: Softmax(0.6),
    "on_policy": Softmax,
    "hot": lambda: Softmax(1.5),
}
OFF_POLICY = {k: v for k, v in COVERING.items() if k != "on_policy"} | {"argmax": Argmax}


def distance(a, b):
    return float((a - b).abs().max())


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
