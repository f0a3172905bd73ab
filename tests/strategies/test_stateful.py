"""Strategies that remember: within an episode, or from iteration to iteration."""

import logging
import re

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictSequential

from trl_explore.collectors import (
    FusedCollector,
    NotCompilableError,
    SteppingCollector,
    TorchRLCollector,
    auto_collector,
)
from trl_explore.envs import make_env
from trl_explore.policies import LinearPolicy
from trl_explore.strategies import VDBE, CountBonus, EpsilonZGreedy, ParameterNoise

STATEFUL = [EpsilonZGreedy, VDBE, CountBonus, ParameterNoise]


def collector(kind, strategy, trials=4, *, seed=0, first_trial=0, max_steps=40, **options):
    torch.set_num_threads(1)
    env = make_env("CartPole-v1", trials, max_steps, seed=seed, first_trial=first_trial)
    policy = LinearPolicy(env, seed=seed, first_trial=first_trial)
    return kind(env, TensorDictSequential(policy, strategy), **options)


def flat(data):
    return {k: v.clone() for k, v in data.flatten_keys(".").items() if k != "trial"}


@pytest.mark.parametrize("kind", STATEFUL)
def test_a_trial_alone_is_the_trial_among_others(kind):
    """With what it has learnt, while others stop."""
    many, alone = kind(), kind()
    whole, single = (
        collector(TorchRLCollector, many, 4, seed=3),
        collector(TorchRLCollector, alone, 1, seed=3, first_trial=2),
    )
    active = np.ones(4, dtype=np.bool_)
    for iteration in range(6):
        data, own = whole.collect(active).frames, single.collect().frames
        one, two = flat(data[data["trial"] == 2]), flat(own)
        assert one.keys() == two.keys()
        assert all(torch.equal(one[key], two[key]) for key in one)
        many.step(data)
        alone.step(own)
        active[1] = iteration < 2


@pytest.mark.parametrize("kind", STATEFUL)
def test_a_checkpoint_goes_on_as_if_nothing_had_happened(kind):
    first = collector(TorchRLCollector, kind())
    for _ in range(3):
        first.strategy.step(first.collect().frames)
    second = collector(TorchRLCollector, kind())
    second.load_state_dict(first.state_dict())
    for _ in range(3):
        one, two = first.collect().frames, second.collect().frames
        assert all(
            torch.equal(a, b) for a, b in zip(flat(one).values(), flat(two).values(), strict=True)
        )
        first.strategy.step(one)
        second.strategy.step(two)


@pytest.mark.parametrize("kind", STATEFUL)
def test_states_are_plain(kind):
    """Tensors only: a checkpoint is read without pickle, and by safetensors."""
    episodes = collector(TorchRLCollector, kind())
    episodes.strategy.step(episodes.collect().frames)
    for value in episodes.strategy.state_dict().values():
        assert isinstance(value, torch.Tensor)


@pytest.mark.parametrize("kind", STATEFUL)
def test_learning_changes_nothing_within_an_iteration(kind):
    """The log-probabilities written are those of the strategy as it is until the next step."""
    strategy = kind()
    episodes = collector(TorchRLCollector, strategy)
    for _ in range(3):
        data = episodes.collect().frames
        if strategy.exact:
            logits = episodes.policy[0](data.copy())["logits"].detach()
            probs = strategy.probs(strategy.preferences(data, logits), data["trial"])
            drawn = probs.gather(1, data["action"].unsqueeze(1)).squeeze(1)
            torch.testing.assert_close(data["action_log_prob"], drawn.log())
        strategy.step(data)


# Which collector supports them


@pytest.mark.parametrize("kind", [VDBE, ParameterNoise])
def test_the_fused_collector_serves(kind, caplog):
    with caplog.at_level(logging.INFO):
        assert isinstance(collector(auto_collector, kind()), FusedCollector)
    assert caplog.messages == ["collector: fused"]


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        (EpsilonZGreedy, "EpsilonZGreedy.*mixture of argmax, softmax and uniform"),
        (CountBonus, "CountBonus.*preferences.*compilable"),
    ],
)
def test_the_fused_collector_refuses_with_the_reason(kind, reason, caplog):
    with caplog.at_level(logging.INFO):
        assert isinstance(collector(auto_collector, kind()), SteppingCollector)
    (message,) = caplog.messages
    assert re.match(f"collector: stepping .*{reason}", message)


def test_several_episodes_at_once_cannot_each_be_begun():
    with pytest.raises(NotCompilableError, match=r"ParameterNoise.*episode"):
        collector(FusedCollector, ParameterNoise(), episodes_per_update=2)
    collector(FusedCollector, VDBE(), episodes_per_update=2).collect()


def test_the_fused_collector_without_exploration_acts_with_the_policys_own_parameters():
    from torchrl.envs.utils import ExplorationType

    mode = {"exploration_type": ExplorationType.DETERMINISTIC}
    one, two = (
        collector(kind, ParameterNoise(sigma=5.0), **mode)
        for kind in (FusedCollector, TorchRLCollector)
    )
    data, expected = one.collect().frames, two.collect().frames
    assert torch.equal(data["action"], expected["action"])
    logits = two.policy[0](expected.copy())["logits"]
    assert torch.equal(expected["action"], logits.argmax(-1))
