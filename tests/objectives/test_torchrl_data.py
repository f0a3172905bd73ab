"""The loss on data as TorchRL programs have them: against a loop over the frames in Python."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torch.distributions import Categorical, Normal
from torchrl.collectors import Collector
from torchrl.data import MultiCategorical, MultiOneHot
from torchrl.envs import SerialEnv
from torchrl.envs.libs.gym import GymEnv
from torchrl.modules import (
    MaskedCategorical,
    MultiAgentMLP,
    NormalParamExtractor,
    OneHotCategorical,
    ProbabilisticActor,
    TanhNormal,
    ValueOperator,
)
from torchrl.objectives import ReinforceLoss as TorchRLReinforceLoss

from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.baselines import LeaveOneOut, LinearValue, StepMean
from trl_explore.objectives.corrections import Behaviour, PerStep, Trajectory
from trl_explore.policies.actor import SoftmaxActor
from trl_explore.strategies import EpsilonSoftmax, Gaussian, Softmax

GAMMA = 0.9


def network(n_actions=3, key: Any = "logits", seed=0):
    torch.manual_seed(seed)
    return TensorDictModule(nn.Linear(4, n_actions), ["observation"], [key])


def categorical(module, key: Any = "logits", kind: Any = Categorical):
    return ProbabilisticActor(module, in_keys={"logits": key}, distribution_class=kind)


def frames(*batch, n_actions=3, seed=0, dtype=torch.float32):
    g = torch.Generator().manual_seed(seed)
    return TensorDict(
        {
            "observation": torch.randn(*batch, 4, generator=g).to(dtype),
            "action": torch.randint(n_actions, batch, generator=g),
            "next": {
                "reward": torch.randn(*batch, 1, generator=g).to(dtype),
                "done": torch.rand(*batch, 1, generator=g) < 0.2,
            },
        },
        list(batch),
    )


def by_loop(log_prob, reward, done, gamma=GAMMA):
    """−Σ_t G_t log π(a_t|s_t) of every row of [rows, time]."""
    losses = []
    for row in range(len(reward)):
        loss, after = torch.zeros(()), 0.0
        for t in reversed(range(reward.shape[1])):
            after = reward[row, t] + gamma * after * (not done[row, t])
            loss = loss - after * log_prob[row, t]
        losses.append(loss)
    return torch.stack(losses)


def log_probs(module, data, key: Any = "logits"):
    logits = module(data.copy())[key].log_softmax(-1)
    return logits.gather(-1, data["action"].unsqueeze(-1)).squeeze(-1)


def expected(module, data):
    reward, done = data["next", "reward"].squeeze(-1), data["next", "done"].squeeze(-1)
    return by_loop(log_probs(module, data), reward, done)


def plain_loss(actor, **options):
    return ReinforceLoss(actor, **{"gamma": GAMMA, "weight": 1.0, **options})


# Shapes and types


@pytest.mark.parametrize("batch", [(3, 1), (1, 1), (1, 5), (3, 5)])
@pytest.mark.parametrize("kind", ["as TorchRL", "no last dimension", "action", "one-hot", "int8"])
def test_every_shape_of_the_same_data(batch, kind):
    module = network()
    data = frames(*batch)
    losses = expected(module, data)
    if kind == "no last dimension":
        data["next"] = data["next"].apply(lambda x: x.squeeze(-1))
    elif kind == "action":
        data["action"] = data["action"].unsqueeze(-1)
    elif kind == "one-hot":
        data["action"] = nn.functional.one_hot(data["action"], 3)
    elif kind == "int8":
        data["action"] = data["action"].to(torch.int8)
        data["next", "done"] = data["next", "done"].to(torch.int8)
    for actor in (categorical(module), SoftmaxActor(module)):
        loss = plain_loss(actor)
        torch.testing.assert_close(loss(data)["trial_loss"], losses.detach())
        assert loss.advantage(data).shape == batch


def test_one_hot_distributions_take_one_hot_actions():
    module, data = network(), frames(3, 5)
    losses = expected(module, data)
    data["action"] = nn.functional.one_hot(data["action"], 3)
    out = plain_loss(categorical(module, kind=OneHotCategorical))(data)
    torch.testing.assert_close(out["trial_loss"], losses.detach())


def test_a_batch_of_more_dimensions_has_a_trial_for_every_row():
    module, data = network(), frames(2, 3, 5)
    out = plain_loss(categorical(module))(data)
    torch.testing.assert_close(out["trial_loss"], expected(module, data.reshape(6, 5)).detach())


def test_one_trial_of_all_rows():
    module, data = network(), frames(3, 5)
    out = plain_loss(categorical(module), trials=1)(data)
    torch.testing.assert_close(out["trial_loss"], expected(module, data).sum(0, True).detach())
    data["next", "done"][:] = False
    rows = data["next", "reward"].squeeze(-1)  # the other rows at the same step are the baseline
    loss = plain_loss(categorical(module), trials=1, baseline=LeaveOneOut(), gamma=0.0)
    torch.testing.assert_close(loss.advantage(data), rows - (rows.sum(0) - rows) / 2)


def test_double_precision_stays_double():
    module = network().double()
    data = frames(3, 5, dtype=torch.float64)
    losses = expected(module, data)
    out = plain_loss(categorical(module))(data)
    assert out["loss_actor"].dtype == torch.float64
    torch.testing.assert_close(out["loss_actor"], losses.sum())


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_logits_of_half_precision_have_a_ratio_of_single_precision(dtype):
    module, data = network().to(dtype), frames(200)
    data["observation"] = data["observation"].to(dtype)
    logits = module(data.copy())["logits"].float().log_softmax(-1)
    log_pi = logits.gather(-1, data["action"].unsqueeze(-1)).squeeze(-1).detach()
    data["action_log_prob"] = log_pi
    loss = plain_loss(SoftmaxActor(module), gamma=0.0, correction=PerStep())
    reward = data["next", "reward"].squeeze(-1)
    torch.testing.assert_close(loss.advantage(data), reward, rtol=1e-6, atol=0)


def test_a_call_with_keywords_whose_entries_are_all_columns():
    torch.manual_seed(0)
    net = TensorDictModule(nn.Linear(1, 2), ["observation"], ["loc_scale"])
    split = TensorDictModule(NormalParamExtractor(), ["loc_scale"], ["loc", "scale"])
    actor = ProbabilisticActor(
        TensorDictSequential(net, split), in_keys=["loc", "scale"], distribution_class=Normal
    )
    entries = {name: torch.randn(6, 1) for name in ("observation", "action", "next_reward")}
    loc, scale = NormalParamExtractor()(net.module(entries["observation"]))
    log_prob = Normal(loc, scale).log_prob(entries["action"])
    found, _ = plain_loss(actor)(**entries, next_done=torch.zeros(6, 1, dtype=torch.bool))
    losses = by_loop(log_prob.T, entries["next_reward"].T, torch.zeros(1, 6))
    torch.testing.assert_close(found, losses.sum())


# Episodes


def test_an_episode_ends_where_the_trajectory_changes():
    module = network()
    data = frames(12)
    data["next", "done"][:] = False
    data["collector", "traj_ids"] = torch.tensor([0] * 5 + [1] * 3 + [0] * 4)
    rows = [expected(module, part.unsqueeze(0)) for part in data.split([5, 3, 4])]
    loss = plain_loss(categorical(module))
    torch.testing.assert_close(loss(data)["trial_loss"], sum(rows).detach())
    renamed = data.exclude("collector").set("episode", data["collector", "traj_ids"])
    loss.set_keys(traj_ids="episode")
    torch.testing.assert_close(loss(renamed)["trial_loss"], sum(rows).detach())


def test_frames_that_a_worker_did_not_deliver_are_no_frames():
    module = network()
    data = frames(2, 6)
    ids = torch.tensor([[0, 0, 0, -1, -1, -1], [1, 1, 1, 1, 2, 2]])
    data["collector", "traj_ids"] = ids
    data["next", "reward"][0, 3:] = torch.nan
    data["observation"][0, 3:] = torch.nan
    parts = [data[0, :3], data[1, :4], data[1, 4:]]
    first, *second = (expected(module, part.unsqueeze(0))[0].detach() for part in parts)
    loss = plain_loss(categorical(module))
    torch.testing.assert_close(loss(data)["trial_loss"], torch.stack([first, sum(second)]))
    assert loss.advantage(data)[0, 3:].tolist() == [0, 0, 0]


@pytest.mark.parametrize("dtype", [torch.bool, torch.uint8, torch.float32])
def test_padding_may_be_of_any_type(dtype):
    module = network()
    data = frames(2, 4)
    data["collector", "mask"] = torch.tensor([[1, 1, 0, 0], [1, 1, 1, 1]]).to(dtype)
    parts = [expected(module, data[:1, :2]), expected(module, data[1:])]
    out = plain_loss(categorical(module))(data)["trial_loss"]
    torch.testing.assert_close(out, torch.cat(parts).detach())


@pytest.mark.filterwarnings("ignore:split_trajs=True produces:UserWarning")
@pytest.mark.parametrize(
    "layout",
    [
        {"frames_per_batch": 60},
        {"frames_per_batch": 60, "split_trajs": True},
        {"frames_per_batch": 21, "trajs_per_batch": 3, "traj_format": "padded"},
        {"frames_per_batch": 21, "trajs_per_batch": 3, "traj_format": "cat"},
    ],
    ids=["rows", "split", "padded", "cat"],
)
@pytest.mark.parametrize("copies", [1, 3])
def test_data_of_torchrls_collectors(layout, copies):
    """Against a loop over the trajectories, and against TorchRL's loss of the same advantage."""
    torch.manual_seed(3)

    def make():
        return GymEnv("CartPole-v1", categorical_action_encoding=True)

    env = make() if copies == 1 else SerialEnv(copies, make)
    env.set_seed(0)
    module = network(2)
    collector = Collector(
        env, TensorDictSequential(module, Softmax()), total_frames=-1, **layout,
        auto_register_policy_transforms=True,
    )  # fmt: skip
    data = next(iter(collector))
    collector.shutdown()
    actor = categorical(module)
    loss = plain_loss(actor, gamma=0.99)
    out = loss(data)["loss_actor"]

    valid = data.get(("collector", "mask"), torch.ones(data.shape, dtype=torch.bool))
    flat = data[valid.reshape(data.shape)]
    ids, total = flat["collector", "traj_ids"].reshape(-1), torch.zeros(())
    for id in ids.unique():
        part = flat[ids == id]
        reward, done = part["next", "reward"].T, part["next", "done"].T
        total = total + by_loop(log_probs(module, part).unsqueeze(0), reward, done, 0.99).sum()
    torch.testing.assert_close(out, total, rtol=1e-5, atol=1e-5)

    critic = ValueOperator(nn.Linear(4, 1), in_keys=["observation"])
    theirs = TorchRLReinforceLoss(actor, critic, reduction="sum")
    advantage = loss.advantage(data).unsqueeze(-1)
    given = data.copy().update({"advantage": advantage, "value_target": advantage})
    other = theirs(given)["loss_actor"]
    torch.testing.assert_close(out, other)
    parameters = list(actor.parameters())
    torch.testing.assert_close(
        torch.autograd.grad(out, parameters), torch.autograd.grad(other, parameters)
    )


# Keys and masks


@pytest.mark.parametrize("logits_key", ["logits", "action_value", ("q", "values")])
@pytest.mark.parametrize("mask_key", [None, "action_mask", "legal"])
def test_the_gradient_of_a_behaviour_that_reads_other_entries(logits_key, mask_key):
    module = network(3, logits_key)
    options = {"logits_key": logits_key, "action_mask_key": mask_key or "action_mask"}
    strategy = EpsilonSoftmax(0.3, **options)
    data, logits = frames(6), module.module(frames(6)["observation"])
    if mask_key:
        mask = nn.functional.one_hot(data["action"], 3) + torch.tensor([1, 0, 0]) > 0
        data[mask_key] = mask.to(torch.uint8)
        logits = logits.masked_fill(~mask, -torch.inf)
    mu = strategy.probs(logits).gather(-1, data["action"].unsqueeze(-1)).squeeze(-1)
    losses = by_loop(mu.log()[None], data["next", "reward"].T, data["next", "done"].T)
    loss = plain_loss(categorical(module, logits_key), correction=Behaviour(), strategy=strategy)
    torch.testing.assert_close(loss(data)["loss_actor"], losses.sum())


@pytest.mark.parametrize("spec", [MultiOneHot([3, 2]), MultiCategorical([3, 2])])
def test_the_gradient_of_a_behaviour_with_several_heads(spec):
    module, data = network(5), frames(6)
    heads = torch.stack([data["action"], data["action"] % 2], -1)
    hot = [nn.functional.one_hot(heads[:, i], n) for i, n in enumerate((3, 2))]
    data["action"] = torch.cat(hot, -1).bool() if isinstance(spec, MultiOneHot) else heads
    data["action_mask"] = torch.cat(hot, -1).bool() | torch.tensor([1, 0, 0, 1, 0]).bool()
    strategy = EpsilonSoftmax(0.3, 2.0, spec=spec)
    logits = module.module(data["observation"]).masked_fill(~data["action_mask"], -torch.inf)
    own = EpsilonSoftmax(0.3, 2.0)
    mu = [own.probs(part).gather(-1, heads[:, i : i + 1]).log().squeeze(-1)
          for i, part in enumerate(logits.split((3, 2), -1))]  # fmt: skip
    torch.testing.assert_close(strategy.log_prob(module(data.copy()), data["action"]), sum(mu))
    losses = by_loop(sum(mu)[None], data["next", "reward"].T, data["next", "done"].T)
    loss = plain_loss(
        categorical(module), correction=Behaviour(), strategy=strategy, entropy_coeff=0.1
    )
    entropy = sum(
        Categorical(own.probs(part), validate_args=False).entropy().sum()
        for part in logits.split((3, 2), -1)
    )
    found, expected = loss(data)["loss_actor"], losses.sum() - 0.1 * loss.weight * entropy
    torch.testing.assert_close(found, expected)
    torch.testing.assert_close(
        torch.autograd.grad(found, loss.parameters()),
        torch.autograd.grad(expected, list(module.parameters())),
    )  # fmt: skip


def test_the_gradient_of_a_continuous_behaviour_without_trials():
    net = nn.Sequential(nn.Linear(4, 4), NormalParamExtractor())
    module = TensorDictModule(net, ["observation"], [("pi", "mean"), ("pi", "width")])
    actor = ProbabilisticActor(
        module, in_keys={"loc": ("pi", "mean"), "scale": ("pi", "width")},
        distribution_class=TanhNormal,
    )  # fmt: skip
    keys: Any = {"loc_key": ("pi", "mean"), "scale_key": ("pi", "width")}
    loss = plain_loss(actor, correction=Behaviour(), strategy=Gaussian(2.0, **keys))
    data = frames(6)
    data["action"] = torch.randn(6, 2)
    loc, scale = net(data["observation"])
    log_prob = Normal(loc, 2 * scale).log_prob(data["action"]).sum(-1)
    losses = by_loop(log_prob[None], data["next", "reward"].T, data["next", "done"].T)
    torch.testing.assert_close(loss(data)["loss_actor"], losses.sum())


def test_a_policy_of_several_modules_is_used_whole():
    module = network()
    half = TensorDictModule(lambda logits: 0.5 * logits, ["logits"], ["scores"])
    actor = ProbabilisticActor(
        TensorDictSequential(module, half), in_keys={"logits": "scores"},
        distribution_class=Categorical,
    )  # fmt: skip
    strategy = Softmax(0.5, logits_key="scores")
    loss = plain_loss(actor, correction=Behaviour(), strategy=strategy)
    data = frames(6)
    # softmax at T = 1/2 of half of the logits: softmax of the logits.
    torch.testing.assert_close(loss(data)["trial_loss"], expected(module, data[None]).detach())


@pytest.mark.parametrize("dtype", [torch.bool, torch.int8, torch.float32])
def test_the_target_obeys_a_mask_of_another_name_and_type(dtype):
    module, data = network(), frames(6)
    mask = nn.functional.one_hot(data["action"], 3) + torch.tensor([1, 0, 0]) > 0
    logits = module.module(data["observation"]).masked_fill(~mask, -torch.inf).log_softmax(-1)
    log_prob = logits.gather(-1, data["action"].unsqueeze(-1)).squeeze(-1)
    losses = by_loop(log_prob[None], data["next", "reward"].T, data["next", "done"].T)
    data["legal"] = mask.to(dtype)
    out = plain_loss(SoftmaxActor(module, action_mask_key="legal"))(data)
    torch.testing.assert_close(out["loss_actor"], losses.sum())
    data["legal"] = mask
    keys: Any = {"logits": "logits", "mask": "legal"}
    torchrls = ProbabilisticActor(module, in_keys=keys, distribution_class=MaskedCategorical)
    torch.testing.assert_close(plain_loss(torchrls)(data)["loss_actor"], losses.sum())


# Several agents


def group(data, agents, *, rewards):
    """Data of a group: a row of ``data`` for each agent, with one reward or one per agent."""
    grouped = data.select("observation", "action").transpose(0, 1).contiguous()  # [time, agents]
    own = {key: data["next", key].transpose(0, 1).contiguous() for key in ("reward", "done")}
    after = {"agents": own} if rewards > 1 else {k: v[:, 0] for k, v in own.items()}
    return TensorDict({"agents": grouped.to_dict(), "next": after}, [data.shape[1]])


def group_actor(agents, share=False):
    torch.manual_seed(1)
    net = MultiAgentMLP(
        4, 3, agents, centralized=False, share_params=share, depth=1, num_cells=8
    )  # vmaps over the agents' parameters
    key = ("agents", "logits")
    module = TensorDictModule(net, [("agents", "observation")], [key])
    return module, categorical(module, key)


def group_log_probs(module, data):
    logits = module(data.copy())["agents", "logits"].log_softmax(-1)
    return logits.gather(-1, data["agents", "action"].unsqueeze(-1)).squeeze(-1)


@pytest.mark.parametrize("padded", [False, True])
def test_every_agent_has_its_own_returns(padded):
    module, actor = group_actor(2)
    data = group(frames(2, 7), 2, rewards=2)
    loss = plain_loss(actor)
    loss.set_keys(action=("agents", "action"), reward=("agents", "reward"), done=("agents", "done"))
    kept = data[:5] if padded else data
    reward, done = (kept["next", "agents", key].squeeze(-1).T for key in ("reward", "done"))
    losses = by_loop(group_log_probs(module, kept).T, reward, done)
    rows = data[None].clone()
    if padded:
        rows["collector", "mask"] = torch.arange(7)[None] < 5
    for given in (rows, *(() if padded else (data,))):
        out = loss(given)
        torch.testing.assert_close(out["loss_actor"], losses.sum())
        assert out["trial_loss"].shape == (1,)
    advantage = loss.advantage(rows)
    assert advantage.shape == (1, 7, 2)
    single = plain_loss(categorical(network())).advantage(frames(2, 7)[:, : len(kept)])
    if not padded:
        torch.testing.assert_close(advantage[0].T, single)


def test_one_reward_belongs_to_the_joint_action():
    module, actor = group_actor(3)
    data = group(frames(3, 7), 3, rewards=1)
    loss = plain_loss(actor)
    loss.set_keys(action=("agents", "action"))
    joint = group_log_probs(module, data).sum(-1)
    losses = by_loop(joint[None], data["next", "reward"].T, data["next", "done"].T)
    torch.testing.assert_close(loss(data)["loss_actor"], losses.sum())


def test_weights_of_agents_are_their_own_and_those_of_a_team_are_joint():
    module, actor = group_actor(2)
    own, team = group(frames(2, 7), 2, rewards=2), group(frames(2, 7), 2, rewards=1)
    log_pi = group_log_probs(module, own).detach()
    log_mu = log_pi - torch.linspace(-0.5, 0.5, 14).reshape(7, 2)
    for data, rewards in ((own, 2), (team, 1)):
        data["agents", "action_log_prob"] = log_mu
        loss = plain_loss(actor, gamma=0.0, correction=PerStep())
        loss.set_keys(
            action=("agents", "action"), sample_log_prob=("agents", "action_log_prob"),
            reward=("agents", "reward") if rewards == 2 else "reward",
        )  # fmt: skip
        if rewards == 2:
            loss.set_keys(done=("agents", "done"))
            ratio, reward = (log_pi - log_mu).exp(), data["next", "agents", "reward"].squeeze(-1)
        else:
            ratio = (log_pi - log_mu).sum(-1).exp()
            reward = data["next", "reward"].squeeze(-1)
        torch.testing.assert_close(loss.advantage(data), ratio * reward)


def test_baselines_of_agents_are_their_own():
    _, actor = group_actor(2)
    data = group(frames(2, 6), 2, rewards=2)
    done = torch.zeros(6, 1, dtype=torch.bool)
    done[2] = done[5] = True  # two episodes of three frames; both agents end together
    data["next", "done"] = done
    reward = data["next", "agents", "reward"].squeeze(-1)
    loss = plain_loss(actor, gamma=0.0, baseline=LeaveOneOut())
    loss.set_keys(action=("agents", "action"), reward=("agents", "reward"))
    torch.testing.assert_close(loss.advantage(data), reward - reward.roll(3, 0))
    loss = plain_loss(actor, gamma=0.0, normalize_advantage=True)
    loss.set_keys(action=("agents", "action"), reward=("agents", "reward"))
    scaled = (reward - reward.mean(0)) / reward.std(0, correction=0)
    torch.testing.assert_close(loss.advantage(data), scaled)
    critic = LinearValue(observation_key=("agents", "observation"))
    critic.weight, critic.bias = nn.Parameter(torch.randn(2, 1, 4)), nn.Parameter(torch.ones(2, 1))
    loss = plain_loss(actor, gamma=0.0, baseline=critic)
    loss.set_keys(action=("agents", "action"), reward=("agents", "reward"))
    value = (data["agents", "observation"] * critic.weight[:, 0]).sum(-1) + 1
    torch.testing.assert_close(loss.advantage(data), (reward - value).detach())
    squares = ((reward - value) ** 2).mean(0).sum()
    torch.testing.assert_close(loss(data)["loss_value"], squares)


# Functional use


@pytest.mark.parametrize("kind", [categorical, SoftmaxActor])
@pytest.mark.parametrize("correction", [None, Trajectory()])
def test_a_loss_under_vmap_and_grad(kind, correction):
    """Four policies at once, as an ensemble, against one loss for each."""
    actor, data = kind(network()), frames(3, 5)
    data["action_log_prob"] = torch.full((3, 5), -1.0)
    actors = [kind(network(seed=seed)) for seed in range(4)]
    alone = [plain_loss(each, correction=correction)(data)["loss_actor"] for each in actors]
    stacked: Any = torch.stack([TensorDict.from_module(each).detach().clone() for each in actors])
    for functional in (True, False):
        loss = plain_loss(actor, correction=correction, functional=functional)
        holder = loss.actor_network_params if functional else loss.actor_network

        def value(parameters, loss=loss, holder=holder):
            with parameters.to_module(holder):
                return loss(data)["loss_actor"]

        torch.testing.assert_close(torch.vmap(value)(stacked), torch.stack(alone).detach())
        slopes: Any = torch.vmap(torch.func.grad(value))(stacked)
        for k, one in enumerate(alone):
            expected = torch.autograd.grad(one, list(actors[k].parameters()), retain_graph=True)
            found = [slopes[k][name] for name in (("module", "0", "module", "weight"),)]
            torch.testing.assert_close(found[0], expected[0])


# State


def test_baselines_have_a_state_of_tensors_only():
    module = network()
    losses = [plain_loss(categorical(module), trials=3, baseline=StepMean()) for _ in range(2)]
    losses[0].step(frames(3, 5))
    state = losses[0].state_dict()
    assert all(isinstance(value, torch.Tensor) for value in state.values())
    losses[1].load_state_dict(state)
    data = frames(3, 9, seed=5)  # longer than before
    assert torch.equal(losses[0].advantage(data), losses[1].advantage(data))
    assert losses[1].advantage(data).ne(plain_loss(categorical(module)).advantage(data)).any()


@pytest.mark.parametrize(("copies", "rows"), [(1, 1), (3, 3)])
def test_a_critic_of_torchrls_environments(copies, rows):
    env = GymEnv("CartPole-v1") if copies == 1 else SerialEnv(copies, lambda: GymEnv("CartPole-v1"))
    critic = LinearValue()
    critic.bind(env)
    env.close(raise_if_closed=False)
    assert critic.weight.shape == (rows, 1, 4)
    with torch.no_grad():
        critic.weight.fill_(0.5)
    data = frames(rows, 5)
    loss = plain_loss(categorical(network()), baseline=critic)
    returns = plain_loss(categorical(network())).advantage(data)
    torch.testing.assert_close(loss.advantage(data), returns - data["observation"].sum(-1) / 2)


# What is refused, in one line


def wrong(**entries):
    data = frames(3, 5)
    for name, value in entries.items():
        data[tuple(name.split("__"))] = value
    return data


@pytest.mark.parametrize(
    ("options", "data", "message"),
    [
        ({}, wrong(next__reward=torch.ones(3, 5, 2)), r"'reward' is \[3, 5, 2\].*\[3, 5\]"),
        ({}, wrong(next__done=torch.ones(3, 5, 2)), r"'done' is \[3, 5, 2\].*\[3, 5\]"),
        ({}, wrong(trial=torch.zeros(3, 5)), "'trial' must hold integers, got torch.float32"),
        ({}, wrong(trial=torch.zeros(3, 5, 4).long()), r"'trial' is \[3, 5, 4\]"),
        ({}, wrong(action=torch.zeros(3, 5, 4).long()), r"actions are \[15, 4\].*\[15\]"),
        ({"trials": 2}, wrong(), "trials is 2, but the data have 3 rows"),
        ({"baseline": LinearValue()}, wrong(), r"bind\(env\)"),
        ({"correction": PerStep()}, wrong(), "'action_log_prob'; the data have"),
        ({"correction": PerStep()}, wrong(action_log_prob=torch.zeros(3, 5, 2)), None),
    ],
)
def test_what_does_not_fit(options, data, message):
    for actor in (categorical(network()), SoftmaxActor(network())):
        if message is None:  # one log-probability for each part of a joint action
            plain_loss(actor, **options)(data)
            continue
        with pytest.raises((ValueError, KeyError, RuntimeError), match=message) as error:
            plain_loss(actor, **options)(data)
        assert "\n" not in str(error.value)


def test_masks_that_do_not_fit():
    actor, data = SoftmaxActor(network()), frames(3, 5)
    data["action_mask"] = torch.ones(3, 5, 2, dtype=torch.bool)
    with pytest.raises(ValueError, match=r"mask is \[15, 2\], but the logits are \[15, 3\]"):
        plain_loss(actor)(data)
    data["action_mask"] = torch.zeros(3, 5, 3, dtype=torch.bool)
    with pytest.raises(ValueError, match="no action of finite logit"):
        plain_loss(actor)(data)


def test_parts_of_another_kind():
    module = network()
    with pytest.raises(ValueError, match=r"ProbabilisticActor, got TensorDictModule"):
        ReinforceLoss(module)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"correction must be .*PerStep\(\), got 'per_step'"):
        ReinforceLoss(categorical(module), correction="per_step")  # pyright: ignore
    net = nn.Sequential(nn.Linear(4, 4), NormalParamExtractor())
    squashed = ProbabilisticActor(
        TensorDictModule(net, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"], distribution_class=TanhNormal,
    )  # fmt: skip
    data = frames(6)
    data["action"] = torch.rand(6, 2) - 0.5
    assert plain_loss(squashed)(data)["loss_actor"].isfinite()
    with pytest.raises(ValueError, match="entropy_coeff must be 0: TanhNormal"):
        plain_loss(squashed, entropy_coeff=0.1)(data)
