import math
import re

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torch.distributions import Categorical, Independent, Normal
from torchrl.collectors import Collector
from torchrl.envs import SerialEnv
from torchrl.envs.libs.gym import GymEnv
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ReinforceLoss as TorchRLReinforceLoss

from trl_explore.envs import make_env
from trl_explore.objectives import ReinforceLoss
from trl_explore.policies import LinearPolicy
from trl_explore.policies.actor import SoftmaxActor
from trl_explore.strategies import Softmax

KINDS = ["torch", "ours", "linear"]
LN3 = math.log(3)


# Actors and data


@pytest.fixture(scope="module")
def env():
    env = make_env("CartPole-v1", trials=30)
    yield env
    env.close()


def torch_actor(module=None):
    """A policy that knows nothing of this project."""
    logits = TensorDictModule(module or nn.Linear(4, 3), ["observation"], ["logits"])
    return ProbabilisticActor(logits, in_keys=["logits"], distribution_class=Categorical)


def tabular(kind, env, dtype=torch.float32):
    """An actor of logits (0, ln 3) in every state, that is π = (1/4, 3/4), and its weights."""
    table = torch.tensor([[0.0] * 4, [LN3, 0.0, 0.0, 0.0]], dtype=dtype)
    if kind == "linear":
        policy = LinearPolicy(env)
        policy.module.weight = nn.Parameter(table.expand(30, 2, 4).clone())
        return SoftmaxActor(policy), policy.weight
    module = nn.Linear(4, 2, bias=False)
    module.weight = nn.Parameter(table)
    if kind == "torch":
        return torch_actor(module), module.weight
    policy = TensorDictModule(module, ["observation"], ["logits"])
    return SoftmaxActor(policy), module.weight


def episode(actions, rewards, *, trial=0, done=True, dtype=torch.float32):
    """The frames of one episode, all in state (1, 0, 0, 0)."""
    n = len(actions)
    ends = torch.zeros(n, 1, dtype=torch.bool)
    ends[-1] = done
    observation = torch.zeros(n, 4, dtype=dtype)
    observation[:, 0] = 1
    return TensorDict(
        {
            "observation": observation,
            "trial": torch.full((n,), trial),
            "action": torch.tensor(actions),
            "next": {
                "reward": torch.tensor(rewards, dtype=dtype).unsqueeze(-1),
                "done": ends,
                "terminated": ends,
                "truncated": torch.zeros_like(ends),
            },
        },
        [n],
    )


def random_episodes(lengths, trials=None, n_actions=2, dtype=torch.float32, seed=0):
    """One episode of random frames for each length, one after the other."""
    g = torch.Generator().manual_seed(seed)
    trials = range(len(lengths)) if trials is None else trials
    parts = []
    for length, trial in zip(lengths, trials, strict=True):
        data = episode([0] * length, [0.0] * length, trial=trial, dtype=dtype)
        data["observation"] = torch.randn(length, 4, generator=g).to(dtype)
        data["action"] = torch.randint(n_actions, (length,), generator=g)
        data["next", "reward"] = torch.randn(length, 1, generator=g).to(dtype)
        parts.append(data)
    return torch.cat(parts)


def discount_rewards(r, gamma):
    """take 1D float array of rewards and compute discounted reward (thesis, A.2)"""
    discounted_r = np.zeros_like(r)
    running_add = 0
    for t in reversed(range(0, r.size)):
        running_add = running_add * gamma + r[t]
        discounted_r[t] = running_add
    return discounted_r


def gradients(loss, data, value="loss_actor"):
    loss.zero_grad()
    loss(data)[value].sum().backward()
    return [p.grad.clone() for p in loss.parameters()]


# Numbers worked out by hand

EPISODE = ([1, 0, 1], [1.0, 2.0, 3.0])
# γ = 1/2: G = 2.75, 3.5, 3; less b = 1/2: 2.25, 3, 2.5; times log π, times -w = -1/10.
LOSS = -0.1 * ((2.25 + 2.5) * math.log(0.75) + 3 * math.log(0.25))
# In the logit of action 1: -w (2.25 · 1/4 - 3 · 3/4 + 2.5 · 1/4); in that of action 0 the reverse.
SLOPE = 0.10625


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("functional", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_value_and_gradient_by_hand(kind, functional, dtype, env):
    actor, weight = tabular(kind, env, dtype)
    loss = ReinforceLoss(actor, gamma=0.5, weight=0.1, baseline=0.5, functional=functional)
    out = loss(episode(*EPISODE, dtype=dtype))
    assert out["loss_actor"].dtype == out["trial_loss"].dtype == dtype
    torch.testing.assert_close(out["loss_actor"], torch.tensor(LOSS, dtype=dtype))
    torch.testing.assert_close(out["trial_loss"], torch.tensor([LOSS], dtype=dtype))
    assert not out["trial_loss"].requires_grad
    out["loss_actor"].backward()
    expected = torch.tensor([[-SLOPE, 0, 0, 0], [SLOPE, 0, 0, 0]], dtype=dtype)
    torch.testing.assert_close(weight.grad if kind != "linear" else weight.grad[0], expected)


def test_defaults_are_those_of_the_thesis(env):
    actor, _ = tabular("linear", env)
    loss = ReinforceLoss(actor)
    assert (loss.gamma, loss.weight, loss.baseline.value, loss.reduction) == (
        0.99,
        0.05,
        0.0,
        "sum",
    )
    # Two frames of reward 1: G = 1.99 and 1.
    out = loss(episode([1, 0], [1.0, 1.0]))["loss_actor"]
    expected = -0.05 * (1.99 * math.log(0.75) + math.log(0.25))
    assert out.item() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_policy_whatever_drew_the_action(kind, env):
    # The log-probability is that of the target, not the one under μ that the data carry.
    actor, _ = tabular(kind, env)
    loss = ReinforceLoss(actor, gamma=0.5, weight=0.1, baseline=0.5)
    data = episode(*EPISODE)
    data["action_log_prob"] = torch.tensor([-7.0, -8.0, -9.0])
    data["logits"] = torch.randn(3, 2)
    assert loss(data)["loss_actor"].item() == pytest.approx(LOSS, rel=1e-6)


# Against other formulations


def written_out(logits, data, gamma, weight, baseline=0.0):
    """L = -w Σ_t (G_t - b) log π(a_t|s_t) of one episode, as it stands in the thesis."""
    returns = discount_rewards(data["next", "reward"].squeeze(-1).double().numpy(), gamma)
    probs = logits.exp() / logits.exp().sum(-1, keepdim=True)
    total = 0.0
    for t, action in enumerate(data["action"].tolist()):
        total = total + (returns[t] - baseline) * probs[t, action].log()
    return -weight * total


@pytest.mark.parametrize("gamma", [0.0, 0.9, 0.99, 1.0])
@pytest.mark.parametrize("kind", ["torch", "ours"])
def test_against_autograd_of_the_formula(kind, gamma):
    torch.manual_seed(1)
    module = nn.Sequential(nn.Linear(4, 8), nn.Tanh(), nn.Linear(8, 3)).double()
    actor = torch_actor(module)
    if kind == "ours":
        actor = SoftmaxActor(TensorDictModule(module, ["observation"], ["logits"]))
    lengths = [5, 1, 30]
    data = random_episodes(lengths, n_actions=3, dtype=torch.float64)
    loss = ReinforceLoss(actor, gamma=gamma, weight=0.3, baseline=0.7)
    out = loss(data)
    terms = [
        written_out(module(part["observation"]), part, gamma, 0.3, 0.7)
        for part in data.split(lengths)
    ]
    torch.testing.assert_close(out["trial_loss"], torch.stack(terms).detach())
    torch.testing.assert_close(out["loss_actor"], sum(terms))
    expected = torch.autograd.grad(sum(terms), list(module.parameters()))
    found = torch.autograd.grad(out["loss_actor"], list(module.parameters()))
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("gamma", [0.9, 1.0])
def test_linear_policy_against_autograd_of_the_formula(gamma, masked, env):
    policy = LinearPolicy(env, seed=2).double()
    lengths = [7, 1, 20, 3] + [2] * 26
    data = random_episodes(lengths, dtype=torch.float64)
    if masked:
        data["action_mask"] = torch.ones(len(data), 2, dtype=torch.bool)
    out = ReinforceLoss(SoftmaxActor(policy, masked=masked), gamma=gamma, trials=30)(data)
    terms = [
        written_out(part["observation"] @ policy.weight[k].T, part, gamma, 0.05)
        for k, part in enumerate(data.split(lengths))
    ]
    torch.testing.assert_close(out["trial_loss"], torch.stack(terms).detach())
    (expected,) = torch.autograd.grad(sum(terms), policy.weight)
    (found,) = torch.autograd.grad(out["loss_actor"], policy.weight)
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("reduction", ["sum", "mean"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_against_torchrls_loss_of_the_same_advantage(dtype, reduction):
    torch.manual_seed(2)
    actor = torch_actor(nn.Linear(4, 3).to(dtype))
    data = random_episodes([4, 9], n_actions=3, dtype=dtype)
    ours = ReinforceLoss(actor, gamma=0.9, weight=0.5, baseline=0.25)
    advantage = ours.advantage(data)
    parts = [part["next", "reward"].squeeze(-1).numpy() for part in data.split([4, 9])]
    by_thesis = np.concatenate([discount_rewards(part, 0.9) for part in parts]) - 0.25
    np.testing.assert_allclose(advantage.numpy(), by_thesis, rtol=1e-5)

    critic = ValueOperator(nn.Linear(4, 1).to(dtype), in_keys=["observation"])
    theirs = TorchRLReinforceLoss(actor, critic, reduction=reduction)
    given = data.clone()
    given["advantage"] = torch.tensor(by_thesis, dtype=dtype).unsqueeze(-1)
    given["value_target"] = torch.zeros(13, 1, dtype=dtype)
    # TorchRL's mean is over frames; ours is w times the sum over them.
    factor = 0.5 * (13 if reduction == "mean" else 1)
    a, b = ours(data)["loss_actor"], factor * theirs(given)["loss_actor"]
    torch.testing.assert_close(a, b)
    parameters = list(actor.parameters())
    torch.testing.assert_close(
        torch.autograd.grad(a, parameters), torch.autograd.grad(b, parameters)
    )


@pytest.mark.parametrize("gamma", [0.5, 0.99, 1.0])
@pytest.mark.parametrize(
    "rewards",
    [[1.0], [1.0] * 200, [0.0, 0.0, 5.0], [-1.0, 2.5, 0.0, -3.0], list(np.sin(np.arange(50.0)))],
    ids=len,
)
def test_advantage_is_the_thesis_discount_rewards(rewards, gamma, env):
    loss = ReinforceLoss(tabular("torch", env)[0], gamma=gamma)
    data = episode([0] * len(rewards), rewards, dtype=torch.float64)
    expected = discount_rewards(np.array(rewards), gamma)
    np.testing.assert_allclose(loss.advantage(data).numpy(), expected, rtol=1e-13, atol=1e-13)
    del data["trial"]
    np.testing.assert_allclose(loss.advantage(data).numpy(), expected, rtol=1e-13, atol=1e-13)


# Where an episode ends


def test_truncated_and_terminated_are_treated_alike(env):
    loss = ReinforceLoss(tabular("torch", env)[0])
    terminated = torch.cat([episode([1, 0, 1], [1.0, 2.0, 3.0]), episode([1], [4.0])])
    truncated = terminated.clone()
    truncated["next", "truncated"] = terminated["next", "terminated"].clone()
    truncated["next", "terminated"] = torch.zeros(4, 1, dtype=torch.bool)
    assert loss.advantage(truncated)[2:].tolist() == [3.0, 4.0]
    assert torch.equal(loss(terminated)["loss_actor"], loss(truncated)["loss_actor"])


@pytest.mark.parametrize("kind", KINDS)
def test_trial_boundaries_without_done(kind, env):
    loss = ReinforceLoss(tabular(kind, env)[0], gamma=0.5, trials=30)
    done, cut = (
        torch.cat(
            [
                episode([1, 0], [1.0, 2.0], trial=4, done=end),
                episode([0], [4.0], trial=2, done=end),
                episode([1, 1], [8.0, 16.0], trial=7, done=end),
            ]
        )
        for end in (True, False)
    )
    assert loss.advantage(cut).tolist() == [2.0, 2.0, 4.0, 16.0, 16.0]
    assert torch.equal(loss(cut)["trial_loss"], loss(done)["trial_loss"])
    assert not cut["next", "done"].any()


def test_several_episodes_of_a_trial(env):
    loss = ReinforceLoss(tabular("linear", env)[0], gamma=0.5, trials=30, weight=1.0)
    data = torch.cat([episode([1, 1], [1.0, 2.0], trial=3), episode([1], [4.0], trial=3)])
    assert loss.advantage(data).tolist() == [2.0, 2.0, 4.0]
    out = loss(data)["trial_loss"]
    assert out[3].item() == pytest.approx(-8 * math.log(0.75), rel=1e-6)
    assert out.count_nonzero() == 1


def test_without_trial_all_flat_frames_are_one_trials(env):
    loss = ReinforceLoss(tabular("torch", env)[0], gamma=0.5)
    data = torch.cat([episode([1, 1], [1.0, 2.0]), episode([1], [4.0])])
    expected = loss(data)["loss_actor"]
    out = loss(data.exclude("trial"))
    assert out["trial_loss"].shape == (1,)
    torch.testing.assert_close(out["loss_actor"], expected)


# Trials


@pytest.mark.parametrize("masked", [False, True])
def test_other_lanes_change_nothing(masked, env):
    # `masked` is the way through the distribution; the plain policy has a shorter one.
    g = torch.Generator().manual_seed(0)
    lengths = torch.randint(1, 80, (30,), generator=g).tolist()
    data = random_episodes(lengths)
    data["action_mask"] = torch.ones(len(data), 2, dtype=torch.bool)

    def run(data, trials, first_trial):
        small = env if trials == 30 else make_env("CartPole-v1", trials=trials)
        policy = LinearPolicy(small, seed=1, first_trial=first_trial)
        loss = ReinforceLoss(SoftmaxActor(policy, masked=masked), trials=trials)
        out = loss(data)
        out["loss_actor"].backward()
        return out["trial_loss"], policy.weight.grad

    together, gradient = run(data, 30, 0)
    for k in (0, 7, 29):
        alone = data[data["trial"] == k].clone()
        alone["trial"] = torch.zeros_like(alone["trial"])
        own, own_gradient = run(alone, 1, k)
        assert torch.equal(own[0], together[k])
        assert torch.equal(own_gradient[0], gradient[k])


@pytest.mark.parametrize("kind", KINDS)
def test_a_trial_without_frames_has_no_loss_and_no_gradient(kind, env):
    actor, weight = tabular(kind, env)
    loss = ReinforceLoss(actor, trials=30)
    data = torch.cat([episode([1, 0], [1.0, 2.0], trial=3), episode([0], [4.0], trial=11)])
    out = loss(data)
    assert out["trial_loss"].nonzero().flatten().tolist() == [3, 11]
    out["loss_actor"].backward()
    if kind == "linear":
        assert weight.grad.flatten(1).abs().sum(-1).nonzero().flatten().tolist() == [3, 11]


def test_number_of_trials_is_that_of_the_data(env):
    loss = ReinforceLoss(tabular("torch", env)[0])
    data = torch.cat([episode([1], [1.0], trial=3), episode([0], [4.0], trial=1)])
    assert loss(data)["trial_loss"].shape == (4,)


def test_a_trial_out_of_range_is_an_error(env):
    for kind in KINDS:
        loss = ReinforceLoss(tabular(kind, env)[0], trials=30)
        with pytest.raises((IndexError, RuntimeError)):
            loss(episode([1, 0], [1.0, 1.0], trial=30))


# Reduction


@pytest.mark.parametrize("kind", KINDS)
def test_reductions(kind, env):
    data = torch.cat([episode([1], [1.0], trial=0), episode([0, 0], [4.0, 1.0], trial=1)])
    actor, weight = tabular(kind, env)
    results, slopes = {}, {}
    for reduction in ("none", "sum", "mean"):
        n = 30 if kind == "linear" else 2
        loss = ReinforceLoss(actor, gamma=0.5, weight=1.0, reduction=reduction, trials=n)
        out = loss(data)
        results[reduction] = out["loss_actor"]
        assert torch.equal(out["trial_loss"], results["none"])
        (slopes[reduction],) = torch.autograd.grad(out["loss_actor"].sum(), weight)
    none = results["none"]
    assert none.requires_grad
    expected = torch.tensor([-math.log(0.75), -(4.5 + 1) * math.log(0.25)])
    torch.testing.assert_close(none[:2], expected)
    torch.testing.assert_close(results["sum"], expected.sum())
    torch.testing.assert_close(results["mean"], expected.sum() / n)
    torch.testing.assert_close(slopes["none"], slopes["sum"])
    torch.testing.assert_close(slopes["mean"], slopes["sum"] / n)


# [batch, time] and padding


def padded(lengths, time, *, trailing, with_trial, seed=0, dtype=torch.float32):
    """Rows of episodes with rubbish behind them, and the same episodes flat."""
    flat = random_episodes(lengths, seed=seed, dtype=dtype)
    rows, mask = [], torch.zeros(len(lengths), time, dtype=torch.bool)
    for row, (part, length) in enumerate(zip(flat.split(lengths), lengths, strict=True)):
        rubbish = random_episodes([time], [row], seed=99, dtype=dtype)[: time - length]
        rubbish["observation"][:] = torch.nan
        rubbish["next", "reward"][:] = torch.nan
        rows.append(torch.cat([part, rubbish]))
        mask[row, :length] = True
    data = torch.stack(rows).contiguous()
    data["collector", "mask"] = mask.unsqueeze(-1) if trailing else mask
    return flat, data if with_trial else data.exclude("trial")


@pytest.mark.parametrize("done", [True, False])
@pytest.mark.parametrize("with_trial", [True, False])
@pytest.mark.parametrize("trailing", [True, False])
def test_padding_changes_nothing(trailing, with_trial, done, env):
    actor, weight = tabular("torch", env)
    loss = ReinforceLoss(actor, gamma=0.9, baseline=0.3)
    results = []
    flat, rows = padded([5, 1, 8], 8, trailing=trailing, with_trial=with_trial)
    if not done:
        flat["next", "done"][:] = False
        rows["next", "done"][:] = False
    for data in (flat, rows):
        out = loss(data)
        results.append((out["trial_loss"], torch.autograd.grad(out["loss_actor"], weight)[0]))
    assert results[0][0].shape == (3,)
    torch.testing.assert_close(results[1], results[0])


@pytest.mark.parametrize("masked", [False, True])
def test_padding_changes_nothing_for_the_linear_policy(masked, env):
    policy = LinearPolicy(env, seed=4)
    loss = ReinforceLoss(SoftmaxActor(policy, masked=masked), trials=30)
    flat, rows = padded([5, 1, 8], 8, trailing=False, with_trial=True)
    results = []
    for data in (flat, rows):
        data["action_mask"] = torch.ones(*data.shape, 2, dtype=torch.bool)
        out = loss(data)
        results.append(
            (out["trial_loss"], torch.autograd.grad(out["loss_actor"], policy.weight)[0])
        )
    assert torch.isfinite(results[0][1]).all()
    torch.testing.assert_close(results[1], results[0])


def test_padding_of_flat_frames(env):
    loss = ReinforceLoss(tabular("torch", env)[0], gamma=0.5)
    data = torch.cat([episode([1, 1], [1.0, 2.0], done=False), episode([1, 0], [4.0, 8.0])])
    data["collector", "mask"] = torch.tensor([True, True, False, True])
    kept = data[[0, 1, 3]].exclude("collector").clone()
    kept["next", "done"][1] = True  # the next valid frame does not belong to it
    assert torch.equal(loss(data)["loss_actor"], loss(kept)["loss_actor"])


def test_a_frame_counts_where_every_mask_of_torchrl_says_so(env):
    loss = ReinforceLoss(tabular("torch", env)[0], gamma=0.5, weight=1.0)
    data = torch.cat([episode([1], [2.0**k]) for k in range(4)])
    data["collector", "mask"] = torch.tensor([True, True, False, False])
    data["shifted_valid"] = torch.tensor([True, False, True, False])
    assert loss(data)["loss_actor"].item() == pytest.approx(-math.log(0.75), rel=1e-6)


def test_rows_of_a_batch_are_trials(env):
    loss = ReinforceLoss(tabular("torch", env)[0], gamma=0.5, weight=1.0)
    first, second = episode([1, 1], [1.0, 2.0], done=False), episode([0, 1], [4.0, 8.0])
    out = loss(torch.stack([first, second]).exclude("trial"))["trial_loss"]
    expected = [-(2 + 2) * math.log(0.75), -8 * math.log(0.25) - 8 * math.log(0.75)]
    torch.testing.assert_close(out, torch.tensor(expected))


def by_formula(data, gamma=0.99):
    """Σ_t G_t log π(a_t|s_t) of [batch, time], from the data's own log-probabilities."""
    total = 0.0
    valid = data.get(("collector", "mask"), torch.ones(data.shape, dtype=torch.bool))
    for row in range(len(data)):
        after = 0.0
        frames = valid[row].reshape(-1).nonzero().flatten().tolist()
        for t in reversed(frames):
            if data["next", "done"][row, t].item():
                after = 0.0
            after = data["next", "reward"][row, t].item() + gamma * after
            total += after * data["action_log_prob"][row, t].item()
    return total


@pytest.mark.filterwarnings(
    "ignore:split_trajs=True produces:UserWarning"  # TorchRL recommends another layout
)
@pytest.mark.parametrize("split", [True, False])
def test_data_of_torchrls_collector_on_a_batched_env(split):
    torch.manual_seed(3)
    env = SerialEnv(2, lambda: GymEnv("CartPole-v1", categorical_action_encoding=True))
    env.set_seed(0)
    logits = TensorDictModule(nn.Linear(4, 2), ["observation"], ["logits"])
    collector = Collector(
        env,
        TensorDictSequential(logits, Softmax()),
        frames_per_batch=100,
        total_frames=100,
        split_trajs=split,
        auto_register_policy_transforms=True,
    )
    (data,) = list(collector)
    collector.shutdown()
    assert data.ndim == 2
    assert split == (("collector", "mask") in data.keys(include_nested=True))
    actor = ProbabilisticActor(logits, in_keys=["logits"], distribution_class=Categorical)
    out = ReinforceLoss(actor, weight=1.0)(data)
    assert out["trial_loss"].shape == (len(data),)
    # The behaviour was the target: the log-probabilities of the data are those of π.
    assert out["loss_actor"].item() == pytest.approx(-by_formula(data), rel=1e-4)


# As a LossModule


@pytest.mark.parametrize("kind", KINDS)
def test_data_are_left_alone(kind, env):
    data = torch.cat([episode([1, 0], [1.0, 2.0], trial=1, done=False), episode([0], [4.0])])
    before = data.clone()
    ReinforceLoss(tabular(kind, env)[0], trials=30)(data)
    # The actor may add its "logits", as under TorchRL's own losses.
    assert (data.exclude("logits") == before).all()


@pytest.mark.parametrize("kind", KINDS)
def test_no_gradient_flows_into_the_data(kind, env):
    data = episode([1, 0], [1.0, 2.0])
    data["next", "reward"].requires_grad_()
    ReinforceLoss(tabular(kind, env)[0])(data)["loss_actor"].backward()
    assert data["next", "reward"].grad is None


@pytest.mark.parametrize("kind", KINDS)
def test_functional_and_not_agree_and_share_the_parameters(kind, env):
    actor, weight = tabular(kind, env)
    data = random_episodes([5, 3])
    results = []
    for functional in (True, False):
        loss = ReinforceLoss(actor, functional=functional, trials=30)
        assert loss.functional is functional
        assert [p.data_ptr() for p in loss.parameters()] == [weight.data_ptr()]
        results.append((loss(data)["loss_actor"].detach(), gradients(loss, data)[0]))
        assert torch.equal(weight.grad, results[-1][1])
    assert torch.equal(results[0][0], results[1][0])
    assert torch.equal(results[0][1], results[1][1])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("functional", [True, False])
def test_an_optimiser_of_the_loss_trains_the_policy(kind, functional, env):
    actor, weight = tabular(kind, env)
    before = weight.detach().clone()
    loss = ReinforceLoss(actor, functional=functional)
    optimizer = torch.optim.SGD(loss.parameters(), lr=1.0)
    data = episode([1], [1.0])
    loss(data)["loss_actor"].backward()
    optimizer.step()
    # -∂L/∂logit of the action that was rewarded: w (1 - π) = 0.05 / 4.
    moved = (weight.detach() - before).reshape(-1, 2, 4)[0, :, 0]
    torch.testing.assert_close(moved, torch.tensor([-0.0125, 0.0125]))
    assert loss(data)["loss_actor"] < ReinforceLoss(tabular(kind, env)[0])(data)["loss_actor"]


def test_keys_can_be_renamed(env):
    actor, _ = tabular("torch", env)
    data = torch.cat([episode([1, 0], [1.0, 2.0], trial=1, done=False), episode([0], [4.0])])
    expected = ReinforceLoss(actor)(data)["trial_loss"]
    loss = ReinforceLoss(actor)
    assert set(loss.in_keys) >= {"action", ("next", "reward"), ("next", "done"), "trial"}
    loss.set_keys(action="move", reward="gain", done=("agents", "over"), trial="lane")
    renamed = TensorDict(
        {
            "observation": data["observation"],
            "move": data["action"],
            "lane": data["trial"],
            "next": {
                "gain": data["next", "reward"],
                "agents": {"over": data["next", "done"]},
            },
        },
        [3],
    )
    assert torch.equal(loss(renamed)["trial_loss"], expected)
    assert set(loss.in_keys) >= {"move", ("next", "gain"), "lane", "observation"}
    with pytest.raises(ValueError, match="nonsense"):
        loss.set_keys(nonsense="x")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("with_trial", [True, False])
def test_call_without_a_tensordict(kind, with_trial, env):
    loss = ReinforceLoss(tabular(kind, env)[0], trials=30)
    data = episode(*EPISODE, trial=0)
    entries = {
        "observation": data["observation"],
        "action": data["action"],
        "next_reward": data["next", "reward"],
        "next_done": data["next", "done"],
    }
    if with_trial or kind == "linear":
        entries["trial"] = data["trial"]
    expected = loss(data)
    actor_loss, trial_loss = loss(**entries)
    torch.testing.assert_close(actor_loss, expected["loss_actor"])
    torch.testing.assert_close(trial_loss[0], expected["trial_loss"][0])


@pytest.mark.parametrize("missing", ["action", ("next", "reward"), ("next", "done")])
def test_a_missing_entry(missing, env):
    loss = ReinforceLoss(tabular("torch", env)[0])
    with pytest.raises(KeyError, match=re.escape(f"missing key: {missing!r}; the data have")):
        loss(episode(*EPISODE).exclude(missing))


@pytest.mark.parametrize("trials", [None, 30])
def test_action_mask_in_the_target(trials, env):
    policy = LinearPolicy(env)
    policy.module.weight = nn.Parameter(torch.tensor([[0.0] * 4, [LN3, 0, 0, 0]]).repeat(30, 1, 1))
    actor = SoftmaxActor(policy, masked=True)
    loss = ReinforceLoss(actor, weight=1.0, gamma=1.0, trials=trials)
    data = episode([0, 1], [0.0, 1.0])
    data["action_mask"] = torch.tensor([[True, False], [True, True]])
    # The first action had no alternative: log 1 = 0.
    assert loss(data)["loss_actor"].item() == pytest.approx(-math.log(0.75), rel=1e-6)
    assert "action_mask" in loss.in_keys


@pytest.mark.parametrize("distribution", [TanhNormal, Normal, Independent])
def test_continuous_actions(distribution):
    torch.manual_seed(4)
    size = 1 if distribution is Normal else 2
    net = nn.Sequential(nn.Linear(4, 2 * size), NormalParamExtractor())
    module = TensorDictModule(net, ["observation"], ["loc", "scale"])

    def independent(loc, scale):
        return Independent(Normal(loc, scale), 1)

    actor = ProbabilisticActor(
        module,
        in_keys=["loc", "scale"],
        distribution_class=independent if distribution is Independent else distribution,
    )
    data = random_episodes([4, 3])
    data["action"] = 1.8 * torch.rand(7, size) - 0.9
    loss = ReinforceLoss(actor, weight=1.0, gamma=0.9)
    out = loss(data)
    advantage = torch.cat(
        [
            torch.tensor(discount_rewards(part["next", "reward"].squeeze(-1).numpy(), 0.9))
            for part in data.split([4, 3])
        ]
    )
    loc, scale = net(data["observation"])
    if distribution is TanhNormal:
        x = data["action"].atanh()
        log_prob = (Normal(loc, scale).log_prob(x) - (1 - data["action"] ** 2).log()).sum(-1)
    else:
        log_prob = Normal(loc, scale).log_prob(data["action"]).sum(-1)
    expected = -(advantage * log_prob)
    torch.testing.assert_close(out["loss_actor"], expected.sum(), rtol=1e-4, atol=1e-4)
    per_trial = torch.stack([part.sum() for part in expected.split([4, 3])]).detach()
    torch.testing.assert_close(out["trial_loss"], per_trial, rtol=1e-4, atol=1e-4)


def test_no_frames(env):
    for kind in KINDS:
        loss = ReinforceLoss(tabular(kind, env)[0], trials=30)
        out = loss(episode([0], [0.0])[:0])
        assert out["loss_actor"].item() == 0
        assert out["trial_loss"].tolist() == [0.0] * 30


# Wrong arguments


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"gamma": 1.01}, r"gamma.*\[0, 1\].*1.01"),
        ({"gamma": -0.1}, r"gamma.*\[0, 1\].*-0.1"),
        ({"gamma": math.nan}, r"gamma.*\[0, 1\].*nan"),
        ({"weight": 0.0}, "weight.*> 0.*0.0"),
        ({"weight": -1.0}, "weight.*> 0.*-1.0"),
        ({"baseline": math.inf}, "baseline.*finite.*inf"),
        ({"trials": 0}, "trials.*>= 1.*0"),
        ({"reduction": "median"}, "reduction.*sum, mean, none.*'median'"),
    ],
)
def test_arguments_out_of_range(arguments, message):
    with pytest.raises(ValueError, match=message):
        ReinforceLoss(torch_actor(), **arguments)


def test_an_advantage_of_return_minus_baseline_is_what_is_weighted(env):
    # Twice the weight is twice the loss; a baseline as large as the only return leaves nothing.
    actor, _ = tabular("torch", env)
    data = episode([1], [3.0])
    one, two = (ReinforceLoss(actor, weight=w)(data)["loss_actor"] for w in (1.0, 2.0))
    assert two.item() == pytest.approx(2 * one.item())
    assert ReinforceLoss(actor, baseline=3.0)(data)["loss_actor"].item() == 0


@pytest.mark.parametrize(
    "dtype", [torch.int64, torch.int32, torch.bool, torch.bfloat16, torch.float16]
)
def test_returns_of_rewards_of_other_types_are_float32(dtype):
    end = torch.zeros(600, 1, dtype=torch.bool)
    frames = {"observation": torch.zeros(600, 4), "action": torch.zeros(600, dtype=torch.int64)}
    after = {"reward": torch.ones(600, 1, dtype=dtype), "done": end}
    data = TensorDict({**frames, "next": after}, [600])
    returns = ReinforceLoss(torch_actor(), gamma=0.5).advantage(data)
    assert returns.dtype == torch.float32
    assert returns[-2:].tolist() == [1.5, 1.0]
    assert ReinforceLoss(torch_actor(), gamma=1.0).advantage(data)[0].item() == 600
