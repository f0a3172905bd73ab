"""Every policy that the fused collector compiles, against its own module, and with action masks."""

from __future__ import annotations

from functools import partial

import gymnasium as gym
import numba as nb
import numpy as np
import pytest
import torch
from gymnasium import spaces
from tensordict.nn import TensorDictSequential
from torchrl.envs.utils import ExplorationType

from tests.collectors.test_agreement import assert_same
from trl_explore.collectors import (
    FusedCollector,
    NotCompilableError,
    TorchRLCollector,
)
from trl_explore.collectors.compiled_policies import Network, arrays, compile_network, network_of
from trl_explore.envs import make_env
from trl_explore.envs.kernels import Kernel, kernel_function, register_kernel
from trl_explore.numerics.compiled.philox import random
from trl_explore.policies import LinearPolicy, MLPPolicy, TabularPolicy
from trl_explore.strategies import Argmax, EpsilonGreedy, MixtureStrategy, Softmax
from trl_explore.strategies.mixture import Mixture

POLICIES = {
    "linear": LinearPolicy,
    "table": partial(TabularPolicy, init="normal"),
    "mlp": partial(MLPPolicy, hidden=[12]),
    "deep relu": partial(MLPPolicy, hidden=[9, 3, 16], activation="relu", bias=False),
    "no hidden layer": partial(MLPPolicy, hidden=[]),
}


def build(collector, env, make_policy, strategy, **options):
    env = env() if callable(env) else make_env(trials=40, seed=4, **env)
    policy = make_policy(env, seed=4)
    move(policy, torch.Generator().manual_seed(1))
    return collector(env, TensorDictSequential(policy, strategy), **options), policy


@torch.no_grad()
def move(policy, draws) -> None:
    """Another policy, whose biases are not zero."""
    for parameter in policy.parameters():
        parameter.add_(0.3 * torch.randn(parameter.shape, generator=draws))


@pytest.mark.parametrize("name", POLICIES)
def test_the_logits_are_those_of_the_module_bit_for_bit(name):
    env = make_env("FrozenLake-v1", trials=7)
    policy = POLICIES[name](env)
    move(policy, torch.Generator().manual_seed(0))
    network, parameters = network_of(policy, one_hot=name == "table")
    load, logits = compile_network(network)

    @nb.njit
    def run(values, rows, x, local, own, hidden, out):
        for i in range(len(x)):
            load(values, rows[i], local[i], own, i)
        for i in range(len(x)):
            logits(values, rows[i], local[i], own, i, hidden, x[i], out[i])

    trial = torch.randint(7, (50,), generator=torch.Generator().manual_seed(2))
    if name == "table":
        x = torch.nn.functional.one_hot(trial * 2, 16).float()
    else:
        x = torch.randn(50, 16, generator=torch.Generator().manual_seed(3))
    out = np.full((50, 4), np.nan, dtype=np.float32)
    values = arrays(network, parameters)
    local = np.full((50, network.local), np.nan, dtype=np.float32)
    run(values, trial.numpy(), x.numpy(), local, *network.memory(50), out)
    assert torch.equal(torch.from_numpy(out), policy.module(x, trial))


@pytest.mark.parametrize("name", ["mlp", "deep relu"])
@pytest.mark.parametrize("strategy", [Softmax, lambda: EpsilonGreedy(0.2)])
def test_the_same_episodes_on_cartpole(name, strategy):
    env = {"id": "CartPole-v1", "max_steps": 100}
    check_pair(env, POLICIES[name], strategy)


@pytest.mark.parametrize("name", ["table", "no hidden layer"])
def test_the_same_episodes_on_the_lake(name):
    check_pair({"id": "FrozenLake-v1"}, POLICIES[name], Softmax)


def check_pair(env, make_policy, strategy) -> None:
    fused, policy = build(FusedCollector, env, make_policy, strategy())
    reference, other = build(TorchRLCollector, env, make_policy, strategy())
    draws = torch.Generator().manual_seed(0), torch.Generator().manual_seed(0)
    active = np.ones(fused.trials, dtype=np.bool_)
    for iteration in range(4):
        assert_same(fused.collect(active).frames, reference.collect(active).frames)
        move(policy, draws[0])
        move(other, draws[1])
        active[iteration::5] = False


def test_a_trial_alone_is_the_trial_among_thirty():
    def episode(trials, first_trial):
        env = make_env(trials=trials, first_trial=first_trial)
        policy = POLICIES["mlp"](env, first_trial=first_trial)
        return FusedCollector(env, TensorDictSequential(policy, Softmax())).collect().frames

    together, alone = episode(30, 0), episode(1, 17)
    rows = together["trial"] == 17
    for name in ("observation", "action", "action_log_prob", ("next", "reward")):
        assert torch.equal(together[name][rows], alone[name]), name


def test_large_networks_are_stepped_in_small_groups():
    assert Network("linear", (4, 2)).group() >= 1000
    assert Network("mlp", (4, 32, 32, 2), "tanh", True).group() == 6  # 4 · 1282 bytes of 32 KiB
    assert Network("mlp", (4, 512, 512, 2), "tanh", True).group() == 1


def test_networks_of_others_are_refused():
    class Other(MLPPolicy):
        pass

    env = make_env(trials=2)
    with pytest.raises(NotCompilableError, match="policy Other"):
        FusedCollector(env, TensorDictSequential(Other(env), Softmax()))
    double = TensorDictSequential(MLPPolicy(env).double(), Softmax())
    with pytest.raises(NotCompilableError, match=r"torch\.float64"):
        FusedCollector(env, double)
    few = TensorDictSequential(MLPPolicy(make_env(trials=3)), Softmax())
    with pytest.raises(NotCompilableError, match=r"weights.*\[3, 32, 4\]"):
        FusedCollector(env, few)


# Action masks: a ring of places with a door that is closed in turn


class Ring(gym.Env):
    """Four moves around a ring; the one whose number is the place modulo 4 is forbidden.

    At every place that is divisible by 3, only one move is allowed.
    """

    SIZE = 10

    def __init__(self, masked: bool = True) -> None:
        self.masked = masked
        self.action_space = spaces.Discrete(4)
        self.observation_space = spaces.Box(0, np.inf, (2,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = int(self.SIZE * self.np_random.random())
        return self.observe(), self.info()

    def step(self, action):
        assert not self.masked or allowed(self.place)[action], "a forbidden action was taken"
        self.place = (self.place + action + 1) % self.SIZE
        over = bool(self.np_random.random() < 0.1)
        return self.observe(), float(action), over, False, self.info()

    def observe(self):
        return np.array([self.place, 1], dtype=np.float32)

    def info(self):
        return {"action_mask": np.array(allowed(self.place))} if self.masked else {}


def allowed(place: int) -> list[bool]:
    return [a == place % 4 if place % 3 == 0 else a != place % 4 for a in range(4)]


@kernel_function
def ring_reset(parameters, state, rng):
    state[0] = int(parameters[0] * random(rng))


@kernel_function
def ring_step(parameters, state, action, rng):
    state[0] = (state[0] + action + 1) % parameters[0]
    return float(action), random(rng) < 0.1


@kernel_function
def ring_observe(parameters, state, observation):
    observation[0], observation[1] = state[0], 1


@kernel_function
def ring_mask(parameters, state, mask):
    place = int(state[0])
    for a in range(4):
        mask[a] = (a == place % 4) if place % 3 == 0 else (a != place % 4)


@register_kernel(Ring)
def ring(env: Ring) -> Kernel:
    functions = ring_reset, ring_step, ring_observe
    return Kernel(*functions, (Ring.SIZE,), state_size=1, n_features=2, n_actions=4, mask=ring_mask)


@pytest.fixture
def ring_env():
    gym.register("Ring-v0", entry_point=Ring, max_episode_steps=40)

    def make(trials=40, masked=True):
        return make_env("Ring-v0", trials=trials, seed=4, kwargs={"masked": masked})

    yield make
    gym.registry.pop("Ring-v0")


class Plane(MixtureStrategy):
    """All three corners at once."""

    def mixture(self):
        return Mixture(greedy=0.3, softmax=0.5, uniform=0.2, temperature=0.7)


@pytest.mark.parametrize("strategy", [Softmax, Argmax, lambda: EpsilonGreedy(0.4), Plane])
def test_masked_episodes_are_the_same(ring_env, strategy):
    fused, _ = build(FusedCollector, ring_env, LinearPolicy, strategy())
    reference, _ = build(TorchRLCollector, ring_env, LinearPolicy, strategy())
    for _ in range(5):
        data = fused.collect().frames
        assert_same(data, reference.collect().frames)
        mask = data["action_mask"]
        assert mask.dtype == torch.bool
        assert mask.tolist() == [allowed(int(place)) for place in data["observation"][:, 0]]
        assert mask.gather(1, data["action"].unsqueeze(-1)).all()


def test_masked_ties_are_shared_by_the_allowed(ring_env):
    """With equal logits, argmax, softmax and uniform are all 1 / (number of allowed actions)."""
    for strategy in (Argmax(), Softmax(), EpsilonGreedy(0.5)):
        collector, policy = build(FusedCollector, ring_env, LinearPolicy, strategy)
        policy.weight.data.zero_()
        data = collector.collect().frames
        probs = 1 / data["action_mask"].sum(-1)
        torch.testing.assert_close(data["action_log_prob"], probs.log())


def test_masked_without_exploration(ring_env):
    options = {"exploration_type": ExplorationType.DETERMINISTIC}
    pair = [
        build(kind, ring_env, LinearPolicy, Softmax(), **options)[0]
        for kind in (FusedCollector, TorchRLCollector)
    ]
    assert_same(pair[0].collect().frames, pair[1].collect().frames)


def test_a_mask_that_the_environment_does_not_deliver_is_not_obeyed(ring_env):
    env = ring_env(trials=3, masked=False)
    collector = FusedCollector(env, TensorDictSequential(LinearPolicy(env), EpsilonGreedy(1.0)))
    data = collector.collect().frames
    assert "action_mask" not in data
    places = data["observation"][:, 0].long()
    taken = torch.tensor([allowed(int(place)) for place in places])[
        range(len(data)), data["action"]
    ]
    assert not taken.all()


def test_a_kernel_without_the_mask_is_refused(ring_env, monkeypatch):
    from trl_explore.envs.kernels import kernel as base

    bare = Kernel(ring_reset, ring_step, ring_observe, (10,), 1, 2, 4)
    monkeypatch.setitem(base._BUILDERS, Ring, lambda env: bare)
    env = ring_env(trials=2)
    with pytest.raises(NotCompilableError, match=r"Ring.*action mask"):
        FusedCollector(env, TensorDictSequential(LinearPolicy(env), Softmax()))
