"""The stepping collector against the TorchRL collector: the same trials, in any environment."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.envs import RewardScaling, Transform
from torchrl.envs.utils import ExplorationType

from tests.collectors.test_agreement import assert_same
from tests.collectors.test_compiled_policies import POLICIES, move, ring_env  # noqa: F401
from tests.envs.test_checking import SUPPORTED
from trl_explore.collectors import (
    NotCompilableError,
    SteppingCollector,
    TorchRLCollector,
    auto_collector,
)
from trl_explore.envs import make_env
from trl_explore.envs.copies import EnvError
from trl_explore.policies import GaussianLinearPolicy, GaussianMLPPolicy, LinearPolicy
from trl_explore.strategies import (
    CountBonus,
    EpsilonGreedy,
    EpsilonMean,
    EpsilonUniform,
    EpsilonZGreedy,
    Gaussian,
    MeanAction,
    ParameterNoise,
    Softmax,
    Strategy,
    UniformAction,
)

CONTINUOUS = {
    "gaussian": Gaussian,
    "cold gaussian": partial(Gaussian, temperature=[0.1, 1.0, 3.0]),
    "uniform": UniformAction,
    "mean": MeanAction,
    "mixture": partial(EpsilonUniform, 0.4),
    "mixture per trial": partial(EpsilonUniform, [0.0, 0.5, 1.0]),
    "mean or uniform": partial(EpsilonMean, 0.4),
}


class Outside(Strategy):
    """A strategy that is no mixture."""

    def probs(self, logits, trial=None):
        return torch.softmax(logits / 2, -1)


def pair(env, make_policy, strategy, **options):
    """Both collectors with equal weights, and a function that moves the weights of both."""
    made = []
    for kind in (SteppingCollector, TorchRLCollector):
        lanes = env() if callable(env) else make_env(**env)
        policy = make_policy(lanes)
        move(policy, torch.Generator().manual_seed(1))
        made.append(kind(lanes, TensorDictSequential(policy, strategy()), **options))
    return made


def check(env, make_policy, strategy, iterations=3, compiled=True, **options) -> None:
    collectors = pair(env, make_policy, strategy, **options)
    assert (collectors[0].why_modules is None) == compiled
    draws = [torch.Generator().manual_seed(0) for _ in collectors]
    active = np.ones(collectors[0].trials, dtype=np.bool_)
    for iteration in range(iterations):
        ours, theirs = (collector.collect(active) for collector in collectors)
        assert_same(ours.frames, theirs.frames)
        assert ours.score.tolist() == theirs.score.tolist()
        assert ours.length.tolist() == theirs.length.tolist()
        for collector, generator, rollout in zip(collectors, draws, (ours, theirs), strict=True):
            move(collector.policy[0], generator)
            collector.strategy.step(rollout.frames)
        active[iteration::3] = False


CARTPOLE = {"id": "CartPole-v1", "trials": 6, "max_steps": 40, "seed": 4, "first_trial": 2}
LANDER = {"id": "LunarLander-v3", "trials": 4, "max_steps": 90}
PENDULUM = {"id": "Pendulum-v1", "trials": 3, "max_steps": 50}


@pytest.mark.parametrize("name", ["linear", "deep relu"])
@pytest.mark.parametrize("strategy", [Softmax, partial(EpsilonGreedy, 0.2)])
def test_policies_with_weights_of_their_own(name, strategy):
    """Small linear ones and networks; the functions of each are those of the fused collector."""
    check(CARTPOLE, POLICIES[name], strategy)


def test_a_table():
    check({"id": "FrozenLake-v1", "trials": 20}, POLICIES["table"], Softmax)


def test_an_environment_without_a_kernel():
    pytest.importorskip("Box2D")
    check(LANDER, LinearPolicy, Softmax)


@pytest.mark.parametrize("strategy", CONTINUOUS)
def test_continuous_actions(strategy):
    check(PENDULUM, GaussianLinearPolicy, CONTINUOUS[strategy])


def test_several_dimensions_and_hidden_layers():
    pytest.importorskip("Box2D")
    env = {"id": "LunarLander-v3", "trials": 3, "max_steps": 60, "kwargs": {"continuous": True}}
    check(env, partial(GaussianMLPPolicy, hidden=[16, 9]), partial(EpsilonUniform, 0.3))


def test_a_scale_of_the_state_runs_in_torch():
    policy = partial(GaussianLinearPolicy, state_dependent_scale=True)
    check(PENDULUM, policy, Gaussian, compiled=False)


@pytest.mark.parametrize("strategy", [Outside, CountBonus, partial(EpsilonZGreedy, 0.4)])
def test_strategies_that_are_not_compiled(strategy):
    check(CARTPOLE, LinearPolicy, strategy, compiled=False)


def test_a_policy_of_ones_own():
    class Half(LinearPolicy):
        def forward(self, tensordict):
            super().forward(tensordict)
            return tensordict.set("logits", tensordict["logits"] / 2)

    check(CARTPOLE, Half, Softmax, compiled=False)


@pytest.mark.parametrize("strategy", [Softmax, ParameterNoise, Outside])
def test_several_episodes_per_update(strategy):
    compiled = strategy is not Outside
    check(CARTPOLE, LinearPolicy, strategy, compiled=compiled, episodes_per_update=3)


@pytest.mark.parametrize("strategy", [Softmax, Outside])
def test_masks(ring_env, strategy):  # noqa: F811
    """The environment returns the masks in ``info``."""
    make = partial(ring_env, trials=10)
    check(make, LinearPolicy, strategy, compiled=strategy is Softmax)
    data = pair(make, LinearPolicy, strategy)[0].collect().frames
    assert data["action_mask"].gather(1, data["action"].unsqueeze(-1)).all()
    assert not data["action_mask"].all()


@pytest.mark.parametrize(
    ("env", "policy", "strategy", "compiled"),
    [
        (CARTPOLE, LinearPolicy, Softmax, True),
        (CARTPOLE, LinearPolicy, Outside, False),
        (PENDULUM, GaussianLinearPolicy, Gaussian, True),
        (PENDULUM, GaussianLinearPolicy, MeanAction, True),
    ],
)
def test_without_exploration(env, policy, strategy, compiled):
    options = {"exploration_type": ExplorationType.DETERMINISTIC}
    check(env, policy, strategy, compiled=compiled, **options)


def test_the_log_grows(monkeypatch):
    from trl_explore.collectors.stepping import collector as module

    whole = pair(CARTPOLE, LinearPolicy, Softmax)[0].collect()
    monkeypatch.setattr(module, "FIRST_FRAMES", 3)
    grown = pair(CARTPOLE, LinearPolicy, Softmax)[0].collect()
    assert_same(grown.frames, whole.frames)


def test_in_several_processes():
    check({**CARTPOLE, "workers": 2}, LinearPolicy, Softmax)


@pytest.mark.parametrize("name", SUPPORTED)
def test_transforms(name):
    """Their state is per trial; the rewards of the score are not transformed."""

    def make():
        return make_env(**CARTPOLE, transforms=[RewardScaling(0.5, 0.3), SUPPORTED[name]()])

    check(make, LinearPolicy, Softmax)


@pytest.mark.parametrize(
    ("env", "policy", "strategy"),
    [
        ({"id": "Taxi-v4", "trials": 3, "max_steps": 20}, LinearPolicy, Outside),
        (PENDULUM, GaussianLinearPolicy, Gaussian),
    ],
)
def test_transforms_with_masks_and_with_continuous_actions(env, policy, strategy):
    stack = SUPPORTED["CatFrames"]

    def make():
        return make_env(**env, transforms=[stack()])

    check(make, policy, strategy, compiled=strategy is Gaussian)


@pytest.mark.parametrize("kind", [SteppingCollector, TorchRLCollector])
def test_a_transform_that_makes_nan_is_named_with_its_place(kind):
    env = make_env(**CARTPOLE, transforms=[RewardScaling(0.0, math.inf)])
    collector = kind(env, TensorDictSequential(LinearPolicy(env), Softmax()))
    place = r"transforms that make reward\[0\] = inf in episode 0 of trial 2$"
    with pytest.raises(EnvError, match=place):
        collector.collect()


def test_what_it_does_not_support_is_refused(caplog):
    class Other(Transform):
        def _inv_call(self, tensordict):
            return tensordict.set("action", 1 - tensordict["action"])

    env = make_env(**CARTPOLE, transforms=[Other(in_keys=[], out_keys=[])])
    both = TensorDictSequential(LinearPolicy(env), Softmax())
    with pytest.raises(NotCompilableError, match="Other changes what the environment gets"):
        SteppingCollector(env, both)
    sent = []
    collector = TorchRLCollector(env, both)
    advance = collector.lanes.advance
    collector.lanes.advance = lambda lanes, actions: (sent.append(actions), advance(lanes, actions))
    drawn = collector.collect(np.arange(6) == 0).frames["action"]
    assert (1 - drawn).tolist() == np.concatenate(sent).tolist()
    reader = TensorDictModule(torch.nn.Identity(), in_keys=[("next", "reward")], out_keys=["bonus"])
    env = make_env(**CARTPOLE)
    both = TensorDictSequential(LinearPolicy(env), reader, Softmax())
    with pytest.raises(NotCompilableError, match="TensorDictModule reads"):
        SteppingCollector(env, both)
    with pytest.raises(NotCompilableError, match="renamed entries"):
        SteppingCollector(env, TensorDictSequential(LinearPolicy(env), Softmax(action_key="act")))


def test_auto_steps_where_there_is_no_kernel(caplog):
    caplog.set_level("INFO", logger="trl_explore")
    env = make_env(**PENDULUM)
    collector = auto_collector(env, TensorDictSequential(GaussianLinearPolicy(env), Gaussian()))
    assert isinstance(collector, SteppingCollector)
    assert caplog.messages[0].startswith("collector: stepping (fused does not apply: ")
