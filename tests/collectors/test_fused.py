from __future__ import annotations

from dataclasses import replace
from functools import wraps

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.envs.classic_control import CartPoleEnv
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.data import OneHot
from torchrl.envs import RewardScaling

from trl_explore.collectors import FusedCollector, NotCompilableError, auto_collector
from trl_explore.collectors.compiled_policies import Network
from trl_explore.collectors.fused import collector as module
from trl_explore.collectors.fused.loop import compile_loop
from trl_explore.collectors.fused.memory import LANES, Scratch, scratch
from trl_explore.envs import make_env
from trl_explore.envs.kernels import kernel as kernel_base
from trl_explore.envs.kernels import kernel_of
from trl_explore.policies import LinearPolicy
from trl_explore.strategies import MixtureStrategy, Softmax, Strategy


class Outside(Strategy):
    """A strategy that is no mixture."""

    def probs(self, logits, trial=None):
        return torch.softmax(-logits, -1)


def build(env, strategy=None, **options) -> FusedCollector:
    policy = LinearPolicy(env)
    return FusedCollector(env, TensorDictSequential(policy, strategy or Softmax()), **options)


def test_it_refuses_what_it_cannot_compile(monkeypatch):
    with pytest.raises(NotCompilableError, match=r"Outside.*mixture"):
        build(make_env(trials=2), Outside())
    with monkeypatch.context() as without:
        without.delitem(kernel_base._BUILDERS, CartPoleEnv)
        with pytest.raises(NotCompilableError, match=r"kernel.*CartPoleEnv"):
            build(make_env(trials=2))
    scaled = make_env(trials=2)
    scaled.append_transform(RewardScaling(0.0, 2.0))
    with pytest.raises(NotCompilableError, match="transform RewardScaling"):
        build(scaled)
    env = make_env(trials=2)
    foreign = TensorDictModule(torch.nn.Linear(4, 2), ["observation"], ["logits"])
    with pytest.raises(NotCompilableError, match="policy TensorDictModule"):
        FusedCollector(env, TensorDictSequential(foreign, Softmax()))


def test_a_foreign_wrapper_is_refused(monkeypatch):
    env = make_env(trials=2)
    lane = env.base_env._env
    lane.envs[0] = gym.wrappers.ClipReward(lane.envs[0], 0, 1)
    with pytest.raises(NotCompilableError, match="wrapper ClipReward"):
        build(env)


def test_auto_falls_back_and_says_why(caplog):
    caplog.set_level("INFO", logger="trl_explore")
    env = make_env(trials=2)
    collector = auto_collector(env, TensorDictSequential(LinearPolicy(env), Outside()))
    assert type(collector).__name__ == "SteppingCollector"
    assert len(caplog.messages) == 1
    assert "Outside" in caplog.messages[0]
    env = make_env(trials=2)
    collector = auto_collector(env, TensorDictSequential(LinearPolicy(env), Softmax()))
    assert type(collector).__name__ == "FusedCollector"
    assert caplog.messages[1:] == ["collector: fused"]


def seven(self, action):
    observation, reward, *rest = STEP(self, action)
    return observation, 7 * reward, *rest


STEP = CartPoleEnv.step


@pytest.mark.parametrize("first", ["replaced", "registered"])
@pytest.mark.parametrize("new", [seven, wraps(STEP)(seven)])
def test_a_method_that_somebody_has_replaced_has_no_kernel(first, new, monkeypatch):
    """The kernel stands for gymnasium's methods, whatever the name of the class."""
    monkeypatch.setattr(CartPoleEnv, "step", new)
    if first == "replaced":  # before the kernels were imported
        monkeypatch.setitem(kernel_base._METHODS, CartPoleEnv, kernel_base._methods(CartPoleEnv))
    with pytest.raises(NotCompilableError, match=r"CartPoleEnv\.step has been replaced"):
        build(make_env(trials=2))
    env = make_env(trials=2)
    collector = auto_collector(env, TensorDictSequential(LinearPolicy(env), Softmax()))
    rollout = collector.collect()
    assert rollout.score.tolist() == (7 * rollout.length).tolist()


def test_a_method_replaced_in_an_instance_has_no_kernel():
    env = make_env(trials=2)
    inner = env.base_env._env.envs[0].unwrapped
    inner.step = lambda action: STEP(inner, action)
    with pytest.raises(NotCompilableError, match=r"CartPoleEnv\.step has been replaced"):
        build(env)


@pytest.mark.parametrize("first_frames", [1, 7])
def test_data_do_not_depend_on_how_often_the_memory_grows(first_frames, monkeypatch):
    one, many = build(make_env(trials=147)), build(make_env(trials=147))
    active = np.arange(147) % 4 != 2
    expected = one.collect(active)
    monkeypatch.setattr(module, "FIRST_FRAMES", first_frames)
    found = many.collect(active)
    for name in expected.frames.keys(True, True):
        assert torch.equal(found.frames[name], expected.frames[name]), name
    assert found.score.tolist() == expected.score.tolist()
    assert found.length.tolist() == expected.length.tolist()


def test_memory_is_reused_and_grows(monkeypatch):
    monkeypatch.setattr(module, "FIRST_FRAMES", 64)
    collector = build(make_env(trials=3))
    collector.policy[0].weight.data[:, 0] = torch.tensor([0.0, -1.0, -8.0, -3.0])
    collector.policy[0].weight.data[:, 1] = 0
    first = collector.collect().frames
    assert len(first) > 3 * 64  # more than was reserved: it had to grow, and lost nothing
    assert (first["next", "step_count"].squeeze(-1).diff()[first["trial"].diff() == 0] == 1).all()
    address = first["observation"].data_ptr()
    assert collector.collect().frames["observation"].data_ptr() == address


def test_the_scratch_of_long_episodes_stays_small():
    kernel, linear = kernel_of(gym.make("CartPole-v1")), Network("linear", (4, 2))
    memory, lanes, _ = scratch(kernel, linear, 500, False)
    assert lanes == LANES <= len(Scratch(*memory).steps)
    memory, lanes, _ = scratch(kernel, linear, 10**6, False)
    assert lanes == len(Scratch(*memory).steps) == 1
    memory, lanes, _ = scratch(kernel, linear, 500, False, episodes=5)
    assert lanes == len(Scratch(*memory).steps) == 5


def test_code_on_disk_is_made_for_the_size_of_the_state():
    """Code for a smaller state, whose functions are the same, would write beside it."""
    kernel, network = kernel_of(gym.make("CartPole-v1")), Network("linear", (4, 2))
    digests = [
        compile_loop(replace(kernel, state_size=size), network)._cache.digest for size in (4, 4, 9)
    ]
    assert digests[0] == digests[1] != digests[2]


def test_a_large_state_is_not_put_on_the_stack(monkeypatch):
    """2.5 MB for 64 lanes took minutes to compile, and four times that have no place there."""
    small = build(make_env(trials=70)).collect().frames
    large = replace(kernel_of(gym.make("CartPole-v1")), state_size=5000)
    monkeypatch.setitem(kernel_base._BUILDERS, CartPoleEnv, lambda env: large)
    assert (build(make_env(trials=70)).collect().frames == small).all()


def test_what_does_not_fit_is_refused():
    """Nothing is read beside the arrays: sizes are compared before."""
    few = LinearPolicy(make_env(trials=3))
    with pytest.raises(NotCompilableError, match=r"weights.*\[3, 2, 4\]"):
        FusedCollector(make_env(trials=50), TensorDictSequential(few, Softmax()))
    lake = make_env("FrozenLake-v1", trials=3)
    with pytest.raises(NotCompilableError, match=r"weights.*\[3, 2, 4\]"):
        FusedCollector(lake, TensorDictSequential(few, Softmax()))
    env = make_env(trials=3)
    with pytest.raises(NotCompilableError, match=r"torch\.float64"):
        FusedCollector(env, TensorDictSequential(LinearPolicy(env).double(), Softmax()))


def test_a_strategy_that_does_more_than_its_mixture_is_refused():
    class Other(Softmax):
        def probs(self, logits, trial=None):
            return torch.softmax(-logits, -1)

    with pytest.raises(NotCompilableError, match=r"Other.*probs"):
        build(make_env(trials=2), Other())
    with pytest.raises(NotCompilableError, match=r"one-hot.*renamed"):
        build(make_env(trials=2), Softmax(spec=OneHot(2)))
    with pytest.raises(NotCompilableError, match=r"one-hot.*renamed"):
        build(make_env(trials=2), Softmax(action_key="act"))


@pytest.mark.parametrize("method", MixtureStrategy.REPLACED)
def test_a_method_that_is_not_called_is_not_passed_over(method):
    changed = type("Changed", (Softmax,), {method: getattr(Softmax, method)})
    stated = type("Stated", (changed,), {"compilable": True})
    mixin = type("Mixin", (), {method: getattr(Softmax, method)})
    assert (Softmax.compilable, changed.compilable, stated.compilable) == (True, False, True)
    assert not type("Mixed", (mixin, Softmax), {}).compilable
    with pytest.raises(NotCompilableError, match="compilable"):
        build(make_env(trials=2), changed())
    build(make_env(trials=2), stated())


@pytest.mark.parametrize("method", MixtureStrategy.REPLACED)
def test_a_method_that_is_put_in_later_is_not_passed_over(method):
    patched, own, hooked = type("Patched", (Softmax,), {}), Softmax(), Softmax()
    setattr(patched, method, lambda self, *args: None)
    setattr(own, method, lambda *args: None)
    hooked.register_forward_hook(lambda module, given, out: out)
    for strategy in (patched(), own, hooked):
        with pytest.raises(NotCompilableError, match=r"compilable|hooks"):
            build(make_env(trials=2), strategy)


def test_batches_of_an_iteration_have_memory_of_their_own():
    collector = build(make_env(trials=3), total_frames=200)
    batches = list(collector)
    assert len(batches) > 1
    again = build(make_env(trials=3))
    for batch in batches:
        assert torch.equal(batch["observation"], again.collect().frames["observation"])
