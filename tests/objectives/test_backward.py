"""``ReinforceLoss.backward`` is the loss's call and its differentiation, bit for bit."""

from __future__ import annotations

from itertools import product

import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from tensordict.nn import TensorDictSequential
from torch import nn

from trl_explore.collectors import FusedCollector, NotCompilableError, TorchRLCollector
from trl_explore.config import CONF
from trl_explore.config.checking import options
from trl_explore.envs import make_env
from trl_explore.objectives import ReinforceLoss
from trl_explore.policies import LinearPolicy
from trl_explore.policies.actor import SoftmaxActor, SoftmaxCategorical, actor_of
from trl_explore.strategies import Softmax

TRIALS = 5
ENVIRONMENTS = {"CartPole-v1": 2, "Acrobot-v1": 3, "FrozenLake-v1": 4}
LOSSES = {
    "plain": {},
    "functional": {"functional": True},
    "entropy": {"entropy_coeff": 0.1},
    "steps": {"discount_steps": True},
    "normalized": {"normalize_advantage": True},
    "each": {"reduction": "none"},
    "mean": {"reduction": "mean"},
    "counted": {"trials": None},
}


def names(group):
    return sorted(path.stem for path in (CONF / group).glob("*.yaml"))


def configured(group, name):
    node = OmegaConf.load(CONF / group / f"{name}.yaml")
    for entry in node.pop("defaults", []):  # "/strategy@strategy: NAME"
        for key, option in entry.items():
            node[key.partition("@")[2]] = OmegaConf.load(CONF / "strategy" / f"{option}.yaml")
    node.pop("lr", None)  # of a policy: the optimiser's learning rate
    return instantiate(node)


@pytest.fixture(scope="module")
def world():
    """Environment, policy, strategy and an iteration's data, by environment and policy."""
    made = {}

    def make(id, policy):
        if (id, policy) not in made:
            env = make_env(id, TRIALS, 30)
            target = configured("policy", policy)(env)
            with torch.no_grad():
                for parameter in target.parameters():
                    parameter += 0.1 * torch.randn(
                        parameter.shape, generator=torch.Generator().manual_seed(1)
                    )
            strategy = Softmax(0.7)
            both = TensorDictSequential(target, strategy)
            data = TorchRLCollector(env, both, episodes_per_update=2).collect().frames
            made[id, policy] = env, target, strategy, data
        return made[id, policy]

    return make


def both_routes(loss, parameters, data, times=1):
    """The losses of the trials and all gradients: by differentiation, and by ``backward``."""
    found = []
    for route in ("graph", "backward"):
        for parameter in parameters:
            parameter.grad = None
        for _ in range(times):
            if route == "backward":
                trial_loss = loss.backward(data)
            else:
                losses = loss(data)
                total = losses["loss_actor"].sum()
                value = losses.get("loss_value", None)
                (total if value is None else total + value.sum()).backward()
                trial_loss = losses["trial_loss"]
        assert not trial_loss.requires_grad
        found.append([trial_loss, *(p.grad.clone() for p in parameters if p.grad is not None)])
    return found


def assert_same(found):
    graph, backward = found
    assert len(graph) == len(backward) > 1
    for one, other in zip(graph, backward, strict=True):
        assert one.dtype == other.dtype
        assert torch.equal(one, other)
        assert one.any()


def build(world, id, policy, correction="none", baseline="constant", **options):
    env, target, strategy, data = world(id, policy)
    learned = configured("baseline", baseline)
    learned.bind(env)
    loss = ReinforceLoss(
        actor_of(target),
        **{"trials": TRIALS, "functional": False, "strategy": strategy, **options},
        correction=configured("correction", correction),
        baseline=learned,
    )
    return loss, [*target.parameters(), *learned.parameters()], data


@pytest.mark.parametrize("correction", names("correction"))
@pytest.mark.parametrize("baseline", names("baseline"))
def test_every_correction_and_baseline(correction, baseline, world):
    loss, parameters, data = build(world, "CartPole-v1", "linear", correction, baseline)
    assert_same(both_routes(loss, parameters, data))
    loss.step(data)  # what has been learned is used
    assert_same(both_routes(loss, parameters, data))


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.parametrize("baseline", ["constant", "linear_value"])
def test_every_form_of_the_loss(name, baseline, world):
    loss, parameters, data = build(
        world, "CartPole-v1", "linear", baseline=baseline, **LOSSES[name]
    )
    assert_same(both_routes(loss, parameters, data, times=2))


@pytest.mark.parametrize(
    ("id", "policy"),
    [
        *product(["CartPole-v1", "Acrobot-v1"], ["linear", "mlp"]),
        *product(["FrozenLake-v1"], options("policy", "discrete")),
    ],
)
@pytest.mark.parametrize("functional", [False, True])
def test_every_policy(id, policy, functional, world):
    loss, parameters, data = build(
        world, id, policy, baseline="episode_mean", functional=functional
    )
    data["next", "reward"].copy_(torch.arange(len(data)).unsqueeze(-1) % 7 - 2)
    assert_same(both_routes(loss, parameters, data))


@pytest.mark.parametrize("layout", ["rows", "shuffled", "masked", "double", "unnamed"])
def test_every_layout(layout, world):
    loss, parameters, data = build(world, "CartPole-v1", "linear")
    n = len(data) // 6 * 6
    if layout == "rows":
        data = data[:n].reshape(6, -1)
    elif layout == "masked":
        mask = torch.ones(len(data), 2, dtype=torch.bool)
        mask[:, 1] = mask[::3, 0] = False
        data = data.clone().set("action_mask", torch.ones_like(mask))
    elif layout == "shuffled":
        order = torch.randperm(len(data), generator=torch.Generator().manual_seed(0))
        data = data[order]
    elif layout == "double":
        data = data.apply(lambda x: x.double() if x.is_floating_point() else x)
        loss = loss.double()
    else:
        data = data[: 6 * TRIALS].reshape(TRIALS, -1).exclude("trial")
        rows = torch.arange(TRIALS).unsqueeze(-1).expand(data.shape)
        loss.set_keys(trial="row")
        data = data.set("row", rows)
    if layout == "double":
        assert_same(both_routes(loss, parameters, data))
        loss.float()
    else:
        assert_same(both_routes(loss, parameters, data))


def test_no_graph_is_made_for_a_linear_policy(world, monkeypatch):
    loss, parameters, data = build(world, "CartPole-v1", "linear")
    monkeypatch.setattr(torch.Tensor, "backward", None)
    loss.backward(data)
    assert parameters[0].grad.any()


def test_a_changed_forward_is_not_passed_over(world):
    class Twice(ReinforceLoss):
        def forward(self, tensordict):
            losses = super().forward(tensordict)
            return losses.apply(lambda x: 2 * x)

    _, target, _, data = world("CartPole-v1", "linear")
    once = ReinforceLoss(actor_of(target), trials=TRIALS, functional=False).backward(data)
    twice = Twice(actor_of(target), trials=TRIALS, functional=False).backward(data)
    assert torch.equal(twice, 2 * once)


def test_a_changed_policy_is_not_passed_over(world):
    class Half(LinearPolicy):
        def forward(self, tensordict, *args, **kwargs):
            out = super().forward(tensordict, *args, **kwargs)
            return out.set("logits", 0.5 * out["logits"])

    env, _, _, data = world("CartPole-v1", "linear")
    changed, hooked, plain = Half(env), LinearPolicy(env), LinearPolicy(env)
    hooked.module.register_forward_hook(lambda module, given, logits: 0.5 * logits)
    plain.weight.data.mul_(0.5)
    expected = ReinforceLoss(actor_of(plain), trials=TRIALS).backward(data)
    for policy in (changed, hooked):
        torch.testing.assert_close(
            ReinforceLoss(actor_of(policy), trials=TRIALS).backward(data), expected
        )
    with pytest.raises(NotCompilableError, match="policy LinearPolicy"):
        FusedCollector(env, TensorDictSequential(hooked, Softmax()))


def test_a_changed_object_is_not_passed_over(world):
    env, _, _, data = world("CartPole-v1", "linear")

    class Half(SoftmaxActor):
        def get_dist(self, tensordict, **options):
            return SoftmaxCategorical(0.5 * self[0](tensordict.copy()).get("logits"))

    plain, biased, patched, squashed = (LinearPolicy(env) for _ in range(4))
    biased.module.bias = nn.Parameter(torch.randn(TRIALS, 2))
    patched.forward = lambda data: data.set("logits", 0.5 * plain(data.copy()).get("logits"))
    nn.utils.parametrize.register_parametrization(squashed.module, "weight", nn.Tanh())
    for actor in (Half(plain), *map(SoftmaxActor, (biased, patched, squashed))):
        for functional in (True, False):
            loss = ReinforceLoss(actor, trials=TRIALS, functional=functional)
            action = data["action"]
            log_prob = actor.get_dist(data.copy()).log_prob(action) * loss.advantage(data)
            expected = log_prob.new_zeros(TRIALS).index_add(0, data["trial"], log_prob)
            found = loss.backward(data)
            torch.testing.assert_close(found, -loss.weight * expected.detach())


def test_a_gradient_goes_on_through_a_weight_that_is_no_leaf(world):
    env, _, _, data = world("CartPole-v1", "linear")
    policy, scale = LinearPolicy(env), nn.Parameter(torch.ones(()))
    loss = ReinforceLoss(actor_of(policy), trials=TRIALS, functional=False)
    weight = policy.module._parameters.pop("weight")
    policy.module.__dict__["weight"] = weight.detach() * scale
    loss.backward(data)
    assert scale.grad


@pytest.mark.parametrize("late", [True, False])
def test_hooks_of_the_weights_are_called(world, late):
    env, _, _, data = world("CartPole-v1", "linear")
    policy = LinearPolicy(env)
    loss = ReinforceLoss(actor_of(policy), trials=TRIALS)
    handle = policy.weight.register_hook(lambda gradient: 0 * gradient)
    if not late:
        loss = ReinforceLoss(actor_of(policy), trials=TRIALS)
    loss.backward(data)
    assert not policy.weight.grad.any()
    handle.remove()
    loss.backward(data)
    assert policy.weight.grad.any()


def test_replaced_weights_are_seen(world):
    env, _, _, data = world("CartPole-v1", "linear")
    policy = LinearPolicy(env)
    loss = ReinforceLoss(actor_of(policy), trials=TRIALS, functional=False)
    before = loss.backward(data)
    for change in ("data", "parameter", "in place"):
        new = torch.full_like(policy.weight, 0.3)
        new[:, 1] = {"data": 0.1, "parameter": 0.2, "in place": -0.3}[change]
        if change == "data":
            policy.weight.data = new
        elif change == "parameter":
            policy.module.weight = nn.Parameter(new)
        else:
            policy.weight.data.copy_(new)
        after = loss.backward(data)
        assert not torch.equal(before, after)
        assert policy.weight.grad.any()
        assert torch.equal(after, loss(data)["trial_loss"])
        before = after


def test_gradients_add_up(world):
    loss, (weight,), data = build(world, "CartPole-v1", "linear")
    weight.grad = None
    loss.backward(data)
    once = weight.grad.clone()
    loss.backward(data)
    assert torch.equal(weight.grad, 2 * once)
    kept, copy = weight.grad, weight.grad.clone()  # a gradient kept stays as it is
    weight.grad = None
    loss.backward(data[: len(data) // 2])
    assert torch.equal(kept, copy)


def test_actions_out_of_range(world):
    loss, _, data = build(world, "CartPole-v1", "linear")
    data = data.clone()
    data["action"][3] = 2
    with pytest.raises(IndexError, match="action"):
        loss.backward(data)
