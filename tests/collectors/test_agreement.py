"""The fused collector against the TorchRL collector: the same trials."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from tensordict.nn import TensorDictSequential
from torchrl.envs.utils import ExplorationType

from trl_explore.collectors import FusedCollector, NotCompilableError, TorchRLCollector
from trl_explore.config.building import STOPPING
from trl_explore.config.checking import options
from trl_explore.envs import lane_env, make_env
from trl_explore.envs.kernels.kernel import _BUILDERS
from trl_explore.policies import LinearPolicy
from trl_explore.strategies import EpsilonGreedy, Softmax

CONF = Path(__file__).resolve().parents[2] / "conf"
STRATEGIES = options("strategy", "discrete")


def env_file(name: str, **changes) -> dict:
    """The arguments of ``make_env`` that a file of ``conf/env`` has."""
    arguments = OmegaConf.to_container(OmegaConf.load(CONF / "env" / f"{name}.yaml"))
    for key in ("_target_", *STOPPING):
        arguments.pop(key, None)
    return {**arguments, **changes}


# Episodes of the slower ones are cut, and fewer: whole ones are compared further down.
ENVS = {
    "cartpole": env_file("cartpole"),
    "cartpole_15": env_file("cartpole_15", max_steps=100),
    "frozenlake8x8": env_file("frozenlake8x8"),
    "short": env_file("cartpole", max_steps=12),
    "frozenlake": env_file("frozenlake", max_steps=40),
    "cliffwalking": env_file("cliffwalking", max_steps=40),
    "taxi": env_file("taxi", max_steps=40),
    "acrobot": env_file("acrobot", max_steps=40),
    "mountaincar": env_file("mountaincar", max_steps=40),
}
FULL = {"cartpole", "frozenlake8x8", "short"}
CORNERS = {"argmax", "epsilon_greedy", "epsilon_softmax", "softmax"}
"""The strategies that are compared in the other environments: what differs there is the kernel."""
PAIRS = [(env, name) for env in ENVS for name in STRATEGIES if env in FULL or name in CORNERS]


def test_every_environment_that_is_compiled_is_compared():
    compared = {lane_class(arguments) for arguments in ENVS.values()}
    assert compared == {env for env in _BUILDERS if env.__module__.startswith("gymnasium")}


def lane_class(arguments: dict) -> type:
    return type(lane_env(make_env(**arguments)).envs[0].unwrapped)


def build(collector, env: dict, strategy, trials: int, seed: int = 4, first_trial: int = 0):
    made = make_env(trials=trials, seed=seed, first_trial=first_trial, **env)
    policy = LinearPolicy(made, seed=seed, first_trial=first_trial)
    return collector(made, TensorDictSequential(policy, strategy)), policy


def from_file(name: str):
    return instantiate(OmegaConf.load(CONF / "strategy" / f"{name}.yaml"))


def assert_same(fused, reference, rtol: float = 1e-5) -> None:
    """Equal frame by frame; the message names the first difference."""
    keys = set(reference.keys(True, True))
    assert set(fused.keys(True, True)) == keys
    n = min(len(fused), len(reference))
    for name in sorted(keys, key=str):
        ours, theirs = fused[name][:n], reference[name][:n]
        assert ours.dtype == theirs.dtype, name
        assert ours.shape == theirs.shape, name
        exact = name != "action_log_prob"
        differ = (ours != theirs) if exact else ~torch.isclose(ours, theirs, rtol=rtol, atol=1e-6)
        if differ.any():
            frame = int(differ.reshape(n, -1).any(1).nonzero()[0])
            pytest.fail(
                f"{name} differs first in frame {frame}: trial {int(reference['trial'][frame])}, "
                f"step {int(reference['next', 'step_count'][frame])}: "
                f"{ours[frame].tolist()} against {theirs[frame].tolist()}"
            )
    assert len(fused) == len(reference)


@pytest.mark.parametrize(("env", "name"), PAIRS)
def test_the_same_episodes(env, name):
    """Hundreds of episodes of every strategy file, while the weights move."""
    trials, iterations = (40, 6) if env in FULL else (12, 3)
    strategies = from_file(name), from_file(name)
    if not getattr(strategies[0], "compilable", False):
        with pytest.raises(NotCompilableError, match=type(strategies[0]).__name__):
            build(FusedCollector, ENVS[env], strategies[0], trials)
        return
    fused, policy = build(FusedCollector, ENVS[env], strategies[0], trials)
    reference, other = build(TorchRLCollector, ENVS[env], strategies[1], trials)
    assert torch.equal(policy.weight, other.weight)
    draws = torch.Generator().manual_seed(0)
    active = np.ones(trials, dtype=np.bool_)
    for iteration in range(iterations):
        data = [collector.collect(active).frames for collector in (fused, reference)]
        assert_same(*data)
        with torch.no_grad():
            move = torch.randn(policy.weight.shape, generator=draws)
            policy.weight.add_(move)
            other.weight.add_(move)
        for strategy, frames in zip(strategies, data, strict=True):
            strategy.step(frames)
        active[iteration::5] = False
        if not active.any():
            break


@pytest.mark.parametrize("name", ["acrobot", "cliffwalking", "mountaincar", "taxi"])
def test_whole_episodes(name):
    """Up to the limit of the file, where rounding would have had the time to grow."""
    pairs = [build(c, env_file(name), Softmax(), 5) for c in (FusedCollector, TorchRLCollector)]
    data = pairs[0][0].collect().frames
    assert_same(data, pairs[1][0].collect().frames)
    assert data["next", "step_count"].max() > 150


@pytest.mark.parametrize("temperature", [1e-30, 0.3, 3.0, 1e30])
def test_the_same_at_any_temperature(temperature):
    fused, _ = build(FusedCollector, ENVS["cartpole"], Softmax(temperature), 30)
    reference, _ = build(TorchRLCollector, ENVS["cartpole"], Softmax(temperature), 30)
    assert_same(fused.collect().frames, reference.collect().frames)


def test_one_batch_holds_trials_with_different_epsilon():
    """Each trial of a mixed batch is the trial of a batch with its own ε."""
    epsilons = [0.0, 0.25, 0.5, 1.0]
    mixed, _ = build(FusedCollector, ENVS["cartpole"], EpsilonGreedy(epsilons), 4)
    reference, _ = build(TorchRLCollector, ENVS["cartpole"], EpsilonGreedy(epsilons), 4)
    data = mixed.collect().frames
    assert_same(data, reference.collect().frames)
    for trial, epsilon in enumerate(epsilons):
        alone, _ = build(FusedCollector, ENVS["cartpole"], EpsilonGreedy(epsilon), 4)
        frames = alone.collect().frames
        ours, theirs = data[data["trial"] == trial], frames[frames["trial"] == trial]
        assert torch.equal(ours["action"], theirs["action"])
        assert torch.equal(ours["action_log_prob"], theirs["action_log_prob"])


def test_ties_share():
    """With equal logits argmax is a coin, in both collectors the same one."""
    from trl_explore.strategies import Argmax

    pairs = [build(c, ENVS["cartpole"], Argmax(), 50) for c in (FusedCollector, TorchRLCollector)]
    for _, policy in pairs:
        policy.weight.data.zero_()
    data = pairs[0][0].collect().frames
    assert_same(data, pairs[1][0].collect().frames)
    assert 0.4 < data["action"].float().mean() < 0.6
    assert torch.allclose(data["action_log_prob"], torch.tensor(0.5).log())


@pytest.mark.parametrize("env", ENVS)
@pytest.mark.parametrize("zero", [True, False])
def test_the_same_without_exploration(env, zero):
    """Deterministic modes take the first of equals, in both collectors."""
    pairs = [build(c, ENVS[env], Softmax(), 20) for c in (FusedCollector, TorchRLCollector)]
    for collector, policy in pairs:
        collector.exploration_type = ExplorationType.DETERMINISTIC
        if zero:
            policy.weight.data.zero_()
    data = pairs[0][0].collect().frames
    assert_same(data, pairs[1][0].collect().frames)
    assert not data["action_log_prob"].any()


@pytest.mark.parametrize("env", ["cartpole", "frozenlake", "taxi"])
@pytest.mark.parametrize("explores", [False, True])
def test_the_same_outcomes_without_frames(env, explores):
    """As evaluations play them: far episode numbers, greedy or sampled from π.

    Observations in the SIMD lanes, in the scratch, and with masks.
    """
    trials = np.array([0, 0, 1, 2, 2, 2])
    episodes = (1 << 52) + np.array([0, 7, 0, 3, 1, 2])
    played = []
    for collector in (FusedCollector, TorchRLCollector):
        made, policy = build(collector, ENVS[env], Softmax(), 3)
        generator = torch.Generator().manual_seed(7)
        with torch.no_grad():
            policy.weight.copy_(torch.randn(policy.weight.shape, generator=generator))
        made.exploration_type = ExplorationType.RANDOM if explores else ExplorationType.MODE
        played.append(made.play(trials, episodes))
    for fused, reference in zip(*played, strict=True):
        np.testing.assert_array_equal(fused, reference)
