"""The expected gradient of the loss, by enumeration, against the true one of a small MDP.

Every trajectory τ of a random MDP with three states, two actions and three steps is listed, with
its probability under the behaviour policy. The expected gradient Σ_τ P_μ(τ) ∇L(τ) is then exact,
and so is the gradient of the expected return, by automatic differentiation of Σ_τ P(τ) R(τ)."""

import itertools

import numpy as np
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from trl_explore.objectives import ReinforceLoss
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
