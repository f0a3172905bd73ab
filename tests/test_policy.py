import math

import numpy as np
import pytest
import torch
from scipy import stats
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch.distributions import Categorical, kl_divergence
from torchrl.envs.libs.gym import GymEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from trl_explore.actor import SoftmaxActor, SoftmaxCategorical
from trl_explore.envs import make_env
from trl_explore.policies import (
    LaneLinear,
    LinearPolicy,
    glorot_uniform,
    n_actions,
)


@pytest.fixture(scope="module")
def env():
    env = make_env("CartPole-v1", trials=30)
    yield env
    env.close()


# Weights


@pytest.mark.parametrize("trials", [1, 30, 400])
@pytest.mark.parametrize(("n_out", "n_in"), [(2, 4), (3, 6), (4, 16)])
def test_glorot_bound_is_that_of_one_trial(trials, n_out, n_in):
    weight = glorot_uniform(trials, n_out, n_in)
    assert weight.shape == (trials, n_out, n_in)
    assert weight.dtype == torch.float32
    bound = math.sqrt(6 / (n_in + n_out))
    assert weight.abs().max() <= bound
    if trials == 400:
        assert weight.max() > 0.99 * bound
        assert weight.min() < -0.99 * bound


def test_glorot_of_cartpole_is_uniform_within_one():
    draws = glorot_uniform(2000, 2, 4).flatten().numpy()  # √(6 / (4 + 2)) = 1
    assert stats.kstest(draws, stats.uniform(-1, 2).cdf).pvalue > 1e-3


def test_row_k_of_a_batch_is_trial_k_alone():
    together = glorot_uniform(30, 2, 4, seed=3)
    for k in range(30):
        assert torch.equal(together[k], glorot_uniform(1, 2, 4, seed=3, first_trial=k)[0])
    assert torch.equal(together[7:20], glorot_uniform(13, 2, 4, seed=3, first_trial=7))


def test_trials_and_seeds_share_no_weight():
    weights = torch.stack([glorot_uniform(30, 2, 4, seed=seed) for seed in (0, 1, 2, 30)])
    assert len(weights.unique()) == weights.numel()


def test_weights_ignore_the_global_generators():
    with torch.random.fork_rng():
        torch.manual_seed(1)
        first = glorot_uniform(2, 2, 4)
        state = torch.get_rng_state()
        torch.manual_seed(2)
        assert torch.equal(glorot_uniform(2, 2, 4), first)
        torch.manual_seed(1)
        assert torch.equal(torch.get_rng_state(), state)


# The linear policy


def test_sizes_come_from_the_specs(env):
    policy = LinearPolicy(env)
    assert policy.weight.shape == (30, 2, 4)
    assert [name for name, _ in policy.named_parameters()] == ["module.weight"]  # no bias
    acrobot = make_env("Acrobot-v1", trials=2)
    assert LinearPolicy(acrobot).weight.shape == (2, 3, 6)
    acrobot.close()


def test_policy_has_the_weights_of_its_trials(env):
    policy = LinearPolicy(env, seed=5, first_trial=11)
    assert torch.equal(policy.weight, glorot_uniform(30, 2, 4, seed=5, first_trial=11))
    assert policy.weight.requires_grad


def test_logits_by_hand():
    weight = torch.tensor([[[1.0, 0.0], [0.0, 2.0]], [[1.0, 1.0], [0.0, -1.0]]])
    policy = TensorDictModule(LaneLinear(weight), ["observation", "trial"], ["logits"])
    data = TensorDict(
        {
            "observation": torch.tensor([[3.0, 4.0], [3.0, 4.0], [0.0, 1.0]]),
            "trial": torch.tensor([1, 0, 1]),
        },
        [3],
    )
    assert policy(data)["logits"].tolist() == [[7.0, -4.0], [3.0, 8.0], [1.0, -1.0]]


def test_policy_writes_logits_and_nothing_else(env):
    policy = LinearPolicy(env)
    assert policy.in_keys == ["observation", "trial"]
    assert policy.out_keys == ["logits"]
    for batch in ([30], [7], [3, 5], []):
        data = TensorDict(
            {"observation": torch.randn(*batch, 4), "trial": torch.randint(30, batch)}, batch
        )
        out = policy(data.clone())
        assert set(out.keys()) == {"observation", "trial", "logits"}
        expected = torch.einsum(
            "...oi,...i->...o", policy.weight[data["trial"]], data["observation"]
        )
        torch.testing.assert_close(out["logits"], expected)


def test_number_of_actions(env):
    assert n_actions(env) == 2


@pytest.mark.parametrize(("id", "kind"), [("Pendulum-v1", "Bounded"), ("CartPole-v1", "OneHot")])
def test_number_of_actions_of_another_spec(id, kind):
    other = GymEnv(id)
    with pytest.raises(ValueError, match=f"needs a Categorical action spec, got {kind}"):
        n_actions(other)
    other.close()


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
