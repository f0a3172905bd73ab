"""The loss on data as TorchRL programs have them: against a loop over the frames in Python."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torch.distributions import Normal
from torchrl.collectors import Collector
from torchrl.envs import SerialEnv
from torchrl.envs.libs.gym import GymEnv
from torchrl.modules import (
    NormalParamExtractor,
    OneHotCategorical,
    ProbabilisticActor,
    ValueOperator,
)
from torchrl.objectives import ReinforceLoss as TorchRLReinforceLoss

from tests.objectives.frames import (
    by_loop,
    categorical,
    expected,
    frames,
    log_probs,
    network,
    plain_loss,
)
from trl_explore.objectives.baselines import LeaveOneOut, LinearValue, StepMean
from trl_explore.objectives.corrections import PerStep, Trajectory
from trl_explore.policies.actor import SoftmaxActor
from trl_explore.strategies import Softmax

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
