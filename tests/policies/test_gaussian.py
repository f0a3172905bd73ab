"""Gaussian policies, and the target policy over them."""

import math

import numpy as np
import pytest
import torch
from scipy import stats
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch.distributions import Independent, Normal
from torchrl.data import Bounded
from torchrl.envs.utils import ExplorationType, set_exploration_type

from trl_explore.envs import make_env
from trl_explore.numerics.layers import lane_sum
from trl_explore.policies import (
    GaussianLinearPolicy,
    GaussianMLPPolicy,
    LinearPolicy,
    MLPPolicy,
    initial_weights,
    n_dims,
)
from trl_explore.policies.actor import (
    DiagonalGaussian,
    GaussianActor,
    SoftmaxActor,
    actor_of,
    frame_log_prob,
)

BOTH = [GaussianLinearPolicy, GaussianMLPPolicy]


class Sizes:
    """What a policy reads of an environment: here BipedalWalker's sizes, without Box2D."""

    def __init__(self, trials, features=24, dims=4):
        self.batch_size = torch.Size([trials])
        self.observation_spec = {"observation": Bounded(-1.0, 1.0, shape=(trials, features))}
        self.action_spec = Bounded(-1.0, 1.0, shape=(trials, dims))


def score_sum(actor, data, action, advantage, trial, trials):
    """Σ A log π(a|s) of every trial, whose gradient is the policy gradient."""
    return lane_sum(frame_log_prob(actor, data, action) * advantage, trial, trials)


@pytest.fixture(scope="module")
def pendulum():
    env = make_env("Pendulum-v1", trials=5)
    yield env
    env.close()


def states(n, features=24, trials=5, seed=0):
    generator = torch.Generator().manual_seed(seed)
    observation = torch.randn(n, features, generator=generator)
    return TensorDict({"observation": observation, "trial": torch.arange(n) % trials}, [n])


def names(policy):
    return {name: tuple(p.shape) for name, p in policy.named_parameters()}


def changed(policy, seed=1):
    """The policy with other numbers in every parameter, so that nothing is 0 or 1."""
    generator = torch.Generator().manual_seed(seed)
    for parameter in policy.parameters():
        parameter.data += 0.3 * torch.randn(parameter.shape, generator=generator)
    return policy


# Sizes and initial values


def test_parameters_have_the_trials_first(pendulum):
    assert names(GaussianLinearPolicy(pendulum)) == {
        "module.log_scale": (5, 1),
        "module.network.layers.0.weight": (5, 1, 3),
        "module.network.layers.0.bias": (5, 1),
    }
    deep = GaussianMLPPolicy(Sizes(7), hidden=[16, 8], bias=False, state_dependent_scale=True)
    assert names(deep) == {
        "module.network.layers.0.weight": (7, 16, 24),
        "module.network.layers.1.weight": (7, 8, 16),
        "module.network.layers.2.weight": (7, 8, 8),
    }


@pytest.mark.parametrize("policy", BOTH)
@pytest.mark.parametrize("dependent", [False, True])
def test_first_scale_is_the_one_asked_for(policy, dependent):
    for value in (0.3, [0.1, 0.2, 0.3, 4.0]):
        built = policy(Sizes(5), initial_scale=value, state_dependent_scale=dependent)
        scale = built(states(20))["scale"]
        torch.testing.assert_close(scale, torch.tensor(value).expand(20, 4))


@pytest.mark.parametrize("dependent", [False, True])
def test_first_mean_is_the_networks(dependent):
    # whatever stands beside it: the same weights as initial_weights gives
    policy = GaussianLinearPolicy(
        Sizes(5), init="he_normal", output_gain=0.5, state_dependent_scale=dependent, seed=3
    )
    (weight,) = initial_weights([24, 4], 5, "he_normal", output_gain=0.5, seed=3)
    data = policy(states(20))
    expected = torch.einsum("foi,fi->fo", weight[data["trial"]], data["observation"])
    torch.testing.assert_close(data["loc"], expected)


@pytest.mark.parametrize("policy", BOTH)
@pytest.mark.parametrize("dependent", [False, True])
def test_row_k_of_a_batch_is_trial_k_alone(policy, dependent):
    many = policy(Sizes(9), state_dependent_scale=dependent, seed=3)
    for k in (0, 4, 8):
        alone = policy(Sizes(1), state_dependent_scale=dependent, seed=3, first_trial=k)
        for a, b in zip(many.parameters(), alone.parameters(), strict=True):
            assert torch.equal(a[k], b[0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"initial_scale": 0.0}, "initial_scale.*0.0"),
        ({"initial_scale": math.inf}, "initial_scale.*inf"),
        ({"initial_scale": "wide"}, "initial_scale.*'wide'"),
        ({"initial_scale": [1.0, 1.0]}, "initial_scale.*2.*4"),
        ({"init": "nonsense"}, "init.*'nonsense'"),
        ({"output_gain": -1.0}, "output_gain.*-1.0"),
        ({"state_dependent_scale": "yes"}, "state_dependent_scale.*'yes'"),
        ({"bias": 2}, "bias.*2"),
    ],
)
@pytest.mark.parametrize("policy", BOTH)
def test_arguments_that_make_no_sense(policy, options, message):
    with pytest.raises(ValueError, match=message):
        policy(Sizes(2), **options)


@pytest.mark.parametrize("hidden", ["32", 32, [0], [-1], [2.5]])
def test_hidden_layers_that_make_no_sense(hidden):
    with pytest.raises(ValueError, match="must be"):
        GaussianMLPPolicy(Sizes(2), hidden=hidden)


@pytest.mark.parametrize("policy", BOTH)
def test_discrete_actions_are_refused(policy):
    env = make_env("CartPole-v1", trials=2)
    with pytest.raises(ValueError, match=r"Bounded or Unbounded.*Categorical"):
        policy(env)
    env.close()


def test_number_of_dimensions(pendulum):
    assert n_dims(pendulum) == 1
    assert n_dims(Sizes(3)) == 4  # pyright: ignore


# The distribution


def test_by_hand():
    policy = GaussianLinearPolicy(Sizes(2, features=2, dims=1), state_dependent_scale=True)
    weight, bias = policy.parameters()
    # rows: the mean, then the logarithm of the scale
    weight.data = torch.tensor([[[1.0, 2.0], [0.0, 0.5]], [[0.0, 0.0], [0.0, 0.0]]])
    bias.data = torch.tensor([[0.5, 0.0], [-1.0, 1.0]])
    observation = torch.tensor([[3.0, 2.0], [3.0, 2.0]])
    data = policy(TensorDict({"observation": observation, "trial": torch.arange(2)}, [2]))
    assert data["loc"].tolist() == [[7.5], [-1.0]]
    torch.testing.assert_close(data["scale"], torch.tensor([[math.e], [math.e]]))


@pytest.mark.parametrize("policy", BOTH)
@pytest.mark.parametrize("dependent", [False, True])
def test_agrees_with_plain_torch(policy, dependent):
    built = changed(policy(Sizes(5), state_dependent_scale=dependent, initial_scale=0.7))
    data = built(states(60))
    layers = built.module.network.layers
    for i, k in enumerate(data["trial"].tolist()):
        h = data["observation"][i]
        for layer in layers[:-1]:
            h = torch.tanh(layer.weight[k] @ h + layer.bias[k])
        out = layers[-1].weight[k] @ h + layers[-1].bias[k]
        log_scale = out[4:] + math.log(0.7) if dependent else built.module.log_scale[k]
        torch.testing.assert_close(data["loc"][i], out[:4])
        torch.testing.assert_close(data["scale"][i], log_scale.exp())


@pytest.mark.parametrize("policy", BOTH)
@pytest.mark.parametrize("dependent", [False, True])
def test_frames_do_not_depend_on_each_other(policy, dependent):
    built = changed(policy(Sizes(5), state_dependent_scale=dependent))
    data = states(37)
    together = built(data.clone())
    for i in range(37):
        alone = built(data[i : i + 1].clone())
        for key in ("loc", "scale"):
            assert torch.equal(alone[key][0], together[key][i])


@pytest.mark.parametrize("batch", [[], [1], [7], [3, 5], [0]])
@pytest.mark.parametrize("dependent", [False, True])
def test_batch_shapes(batch, dependent):
    policy = GaussianMLPPolicy(Sizes(5), state_dependent_scale=dependent)
    data = TensorDict(
        {"observation": torch.randn(*batch, 24), "trial": torch.randint(5, batch)}, batch
    )
    out = policy(data)
    assert out["loc"].shape == out["scale"].shape == (*batch, 4)


def test_the_scale_stays_finite():
    policy = GaussianLinearPolicy(Sizes(2))
    for extreme in (-1e4, 1e4):
        policy.module.log_scale.data.fill_(extreme)
        scale = policy(states(2, trials=2))["scale"]
        assert (scale > 0).all()
        assert scale.isfinite().all()


# The target policy


def test_the_actor_follows_from_what_is_written(pendulum):
    cartpole = make_env("CartPole-v1", trials=2)
    for policy in (LinearPolicy(cartpole), MLPPolicy(cartpole)):
        assert type(actor_of(policy)) is SoftmaxActor
    for kind in BOTH:
        assert type(actor_of(kind(pendulum))) is GaussianActor
    cartpole.close()
    q = TensorDictModule(torch.nn.Linear(4, 2), ["observation"], ["action_value"])
    with pytest.raises(ValueError, match=r"TensorDictModule.*action_value"):
        actor_of(q)


@pytest.mark.parametrize("batch", [(), (5,), (2, 3)])
def test_distribution_is_that_of_torch(batch):
    generator = torch.Generator().manual_seed(0)
    loc, action = (torch.randn(*batch, 4, generator=generator).double() for _ in range(2))
    scale = loc.exp() + 0.1
    ours, torchs = DiagonalGaussian(loc, scale), Independent(Normal(loc, scale), 1)
    assert ours.batch_shape == torchs.batch_shape == batch
    assert ours.event_shape == torchs.event_shape == (4,)
    torch.testing.assert_close(ours.log_prob(action), torchs.log_prob(action))
    torch.testing.assert_close(ours.entropy(), torchs.entropy())
    assert torch.equal(ours.mode, loc)
    several = torch.randn(6, *batch, 4, generator=generator).double()
    torch.testing.assert_close(ours.log_prob(several), torchs.log_prob(several))


def test_the_actor_draws_from_the_policy(pendulum):
    policy = changed(GaussianLinearPolicy(pendulum))
    actor = actor_of(policy)
    assert {id(p) for p in actor.parameters()} == {id(p) for p in policy.parameters()}
    data = states(1, features=3).expand(4000).clone()
    with torch.random.fork_rng(), set_exploration_type(ExplorationType.RANDOM):
        torch.manual_seed(0)
        drawn = actor(data)
    loc, scale = drawn["loc"][0].item(), drawn["scale"][0].item()
    actions = drawn["action"].detach().squeeze(-1).numpy()
    assert stats.kstest(actions, stats.norm(loc, scale).cdf).pvalue > 1e-3
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert torch.equal(actor(data)["action"], drawn["loc"])


def test_score_by_hand():
    # One state x = (1, 2), W = (1, 0), b = 0, scale 2, action 5: z = 2, so that
    # d log pi / d W = (z / scale) x = x and d log pi / d log scale = z^2 - 1 = 3.
    policy = GaussianLinearPolicy(Sizes(1, features=2, dims=1), initial_scale=2.0)
    policy.module.network.layers[0].weight.data = torch.tensor([[[1.0, 0.0]]])
    data = TensorDict(
        {"observation": torch.tensor([[1.0, 2.0]]), "trial": torch.zeros(1, dtype=torch.int64)}, [1]
    )
    action, advantage = torch.tensor([[5.0]]), torch.tensor([10.0])
    score = score_sum(actor_of(policy), data, action, advantage, data["trial"], 1)
    expected = 10 * (-2 - math.log(2) - 0.5 * math.log(2 * math.pi))
    assert score.item() == pytest.approx(expected, rel=1e-6)
    score.sum().backward()
    layer = policy.module.network.layers[0]
    torch.testing.assert_close(layer.weight.grad, torch.tensor([[[10.0, 20.0]]]))
    torch.testing.assert_close(layer.bias.grad, torch.tensor([[10.0]]))
    torch.testing.assert_close(policy.module.log_scale.grad, torch.tensor([[30.0]]))


@pytest.mark.parametrize("policy", BOTH)
@pytest.mark.parametrize("dependent", [False, True])
def test_scores_of_trials_and_their_gradients(policy, dependent):
    built = changed(policy(Sizes(5), state_dependent_scale=dependent)).double()
    data = states(80).apply(lambda x: x.double() if x.is_floating_point() else x)
    generator = torch.Generator().manual_seed(4)
    action = torch.randn(80, 4, generator=generator).double()
    advantage = torch.randn(80, generator=generator).double()
    actor = actor_of(built)
    score = score_sum(actor, data, action, advantage, data["trial"], 5)
    ours = torch.autograd.grad(score.sum(), list(built.parameters()))
    written = built(data.clone())
    log_prob = Independent(Normal(written["loc"], written["scale"]), 1).log_prob(action)
    torch.testing.assert_close(frame_log_prob(actor, data, action), log_prob)
    theirs = torch.autograd.grad((log_prob * advantage).sum(), list(built.parameters()))
    torch.testing.assert_close(ours, theirs)
    expected = np.zeros(5)
    np.add.at(expected, data["trial"].numpy(), (log_prob * advantage).detach().numpy())
    np.testing.assert_allclose(score.detach().numpy(), expected)


@pytest.mark.parametrize("policy", BOTH)
@pytest.mark.parametrize("dependent", [False, True])
def test_a_trials_gradient_is_its_own(policy, dependent):
    """Bit for bit the same, alone as among others."""
    data = states(200)
    data = data[data["trial"].argsort(stable=True)]
    generator = torch.Generator().manual_seed(4)
    action, advantage = torch.randn(200, 4, generator=generator), torch.randn(200)

    def gradients(trials, first, rows):
        built = policy(Sizes(trials), state_dependent_scale=dependent, first_trial=first)
        frames = data[rows].clone()
        frames["trial"] -= first
        score = score_sum(
            actor_of(built), frames, action[rows], advantage[rows], frames["trial"], trials
        )
        return torch.autograd.grad(score.sum(), list(built.parameters()))

    together = gradients(5, 0, slice(None))
    for k in range(5):
        alone = gradients(1, k, data["trial"] == k)
        for a, b in zip(together, alone, strict=True):
            assert torch.equal(a[k], b[0])
