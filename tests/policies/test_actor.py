import math

import numpy as np
import pytest
import torch
from scipy import stats
from tensordict import TensorDict
from torch.distributions import Categorical, kl_divergence
from torchrl.envs.utils import ExplorationType, set_exploration_type

from trl_explore.envs import make_env
from trl_explore.numerics.layers import lane_sum
from trl_explore.policies import LinearPolicy, MLPPolicy
from trl_explore.policies.actor import SoftmaxActor, SoftmaxCategorical, frame_log_prob


def score_sum(actor, data, action, advantage, trial, trials):
    """Σ A log π(a|s) of every trial, whose gradient is the policy gradient."""
    return lane_sum(frame_log_prob(actor, data, action) * advantage, trial, trials)


@pytest.fixture(scope="module")
def env():
    env = make_env("CartPole-v1", trials=30)
    yield env
    env.close()


# The target distribution


def both(batch=(5,), n=4):
    torch.manual_seed(0)
    logits = 2 * torch.randn(*batch, n, dtype=torch.float64)
    return SoftmaxCategorical(logits), Categorical(logits=logits)


@pytest.mark.parametrize("batch", [(), (5,), (2, 3)])
def test_distribution_is_that_of_torch(batch):
    ours, torchs = both(batch)
    assert ours.batch_shape == torchs.batch_shape == batch
    assert ours.event_shape == torchs.event_shape
    for name in ("probs", "logits", "mode"):
        torch.testing.assert_close(getattr(ours, name), getattr(torchs, name))
    torch.testing.assert_close(ours.entropy(), torchs.entropy())
    value = torch.randint(4, batch)
    torch.testing.assert_close(ours.log_prob(value), torchs.log_prob(value))
    torch.testing.assert_close(kl_divergence(ours, ours), torch.zeros(batch).double())
    assert ours.param_shape == (*batch, 4)


def test_distribution_by_hand():
    distribution = SoftmaxCategorical(torch.tensor([0.0, math.log(3.0)]))
    torch.testing.assert_close(distribution.probs, torch.tensor([0.25, 0.75]))
    assert distribution.log_prob(torch.tensor(1)).item() == pytest.approx(math.log(0.75))


def test_samples_have_the_probabilities():
    distribution = SoftmaxCategorical(torch.tensor([0.0, 1.0, -0.5]).double())
    with torch.random.fork_rng():
        torch.manual_seed(0)
        counts = np.bincount(distribution.sample((10_000,)).numpy(), minlength=3)
    assert stats.chisquare(counts, 10_000 * distribution.probs.numpy()).pvalue > 1e-3


def test_mask_forbids():
    logits = torch.tensor([[0.0, 5.0, math.log(3.0)]])
    masked = SoftmaxCategorical(logits, torch.tensor([[True, False, True]]))
    torch.testing.assert_close(masked.probs, torch.tensor([[0.25, 0.0, 0.75]]))
    assert masked.log_prob(torch.tensor([2])).item() == pytest.approx(math.log(0.75))
    assert masked.log_prob(torch.tensor([1])).item() == -math.inf
    assert logits.tolist()[0][1] == 5.0


def test_log_prob_of_many_samples_at_once():
    ours, torchs = both((3,))
    value = torch.randint(4, (5, 3))
    torch.testing.assert_close(ours.log_prob(value), torchs.log_prob(value))


def test_actor_shares_the_parameters_of_the_policy(env):
    policy = LinearPolicy(env)
    actor = SoftmaxActor(policy)
    assert [p.data_ptr() for p in actor.parameters()] == [policy.weight.data_ptr()]
    data = TensorDict({"observation": torch.randn(6, 4), "trial": torch.arange(6)}, [6])
    distribution = actor.get_dist(data)
    expected = torch.einsum("foi,fi->fo", policy.weight[:6], data["observation"]).softmax(-1)
    torch.testing.assert_close(distribution.probs, expected)
    action = torch.tensor([0, 1, 0, 1, 1, 0])
    distribution.log_prob(action).sum().backward()
    assert policy.weight.grad[:6].abs().sum() > 0
    assert policy.weight.grad[6:].abs().sum() == 0


def test_masked_actor(env):
    actor = SoftmaxActor(LinearPolicy(env), masked=True)
    data = TensorDict(
        {
            "observation": torch.randn(2, 4),
            "trial": torch.arange(2),
            "action_mask": torch.tensor([[True, False], [False, True]]),
        },
        [2],
    )
    assert actor.get_dist(data).probs.tolist() == [[1.0, 0.0], [0.0, 1.0]]
    with set_exploration_type(ExplorationType.RANDOM):
        assert actor(data)["action"].tolist() == [0, 1]


# The sum that the loss is made of, for networks


def frames(env, n=200):
    draws = torch.Generator().manual_seed(3)
    trial = torch.randint(30, (n,), generator=draws).sort().values
    data = TensorDict(
        {"observation": torch.randn(n, 4, generator=draws), "trial": trial}, batch_size=[n]
    )
    action = torch.randint(2, (n,), generator=draws)
    return data, action, torch.randn(n, generator=draws)


@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_score_of_a_network_is_that_of_torch(env, activation):
    """Against one torch.nn.Sequential for each trial."""
    policy = MLPPolicy(env, hidden=[16, 9], activation=activation)
    data, action, advantage = frames(env)
    score = score_sum(SoftmaxActor(policy), data, action, advantage, data["trial"], 30)
    score.sum().backward()
    phi = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}[activation]
    for k in range(30):
        layers = [torch.nn.Linear(4, 16), torch.nn.Linear(16, 9), torch.nn.Linear(9, 2)]
        for layer, ours in zip(layers, policy.module.layers, strict=True):
            layer.weight.data, layer.bias.data = ours.weight.data[k], ours.bias.data[k]
        network = torch.nn.Sequential(layers[0], phi(), layers[1], phi(), layers[2])
        rows = data["trial"] == k
        log_prob = Categorical(logits=network(data["observation"][rows])).log_prob(action[rows])
        expected = (log_prob * advantage[rows]).sum()
        torch.testing.assert_close(score[k], expected, rtol=1e-4, atol=1e-5)
        expected.backward()
        for layer, ours in zip(layers, policy.module.layers, strict=True):
            torch.testing.assert_close(ours.weight.grad[k], layer.weight.grad, rtol=1e-3, atol=1e-5)
            torch.testing.assert_close(ours.bias.grad[k], layer.bias.grad, rtol=1e-3, atol=1e-5)


def test_score_of_a_trial_alone_is_that_among_thirty(env):
    together = MLPPolicy(env, hidden=[32, 32])
    data, action, advantage = frames(env, 600)
    score = score_sum(SoftmaxActor(together), data, action, advantage, data["trial"], 30)
    score.sum().backward()
    for k in (0, 7, 29):
        alone = MLPPolicy(make_env(trials=1, first_trial=k), hidden=[32, 32], first_trial=k)
        rows = data["trial"] == k
        own = data[rows].set("trial", torch.zeros(int(rows.sum()), dtype=torch.int64))
        lone = score_sum(
            SoftmaxActor(alone), own, action[rows], advantage[rows], own["trial"], trials=1
        )
        lone.sum().backward()
        assert torch.equal(score[k], lone[0])
        for ours, theirs in zip(together.parameters(), alone.parameters(), strict=True):
            assert torch.equal(ours.grad[k], theirs.grad[0])


def test_score_obeys_a_mask(env):
    """Where only one action is allowed, π is 1, and nothing is learned."""
    policy = MLPPolicy(env, hidden=[5])
    data, action, advantage = frames(env)
    mask = torch.nn.functional.one_hot(action, 2).bool()
    data.set("action_mask", mask)
    score = score_sum(SoftmaxActor(policy), data, action, advantage, data["trial"], 30)
    score.sum().backward()
    assert not score.any()
    assert not any(parameter.grad.any() for parameter in policy.parameters())
