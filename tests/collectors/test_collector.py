"""What every collector does beside collecting: seeds, states, iteration, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.collectors import BaseCollector

from tests.collectors.test_contract import TRIALS, build, collect, of, same, set_weights
from trl_explore.collectors import EpisodeCollector
from trl_explore.envs import make_env
from trl_explore.policies import LinearPolicy
from trl_explore.strategies import DecayingEpsilonGreedy, EpsilonGreedy, Softmax


def test_wrong_episodes_to_play_are_refused(kind):
    collector = build(kind)
    for trials in ([4], [-1], [[0]], [0, 1]):
        with pytest.raises(ValueError, match="trials"):
            collector.play(np.array(trials), np.array([0]))
    collector.shutdown()
    with pytest.raises(RuntimeError, match="shut down"):
        collector.play(np.array([0]), np.array([0]))


def test_seeds(kind):
    zero, one = collect(build(kind, seed=0)), collect(build(kind, seed=1))
    starts = [
        tuple(of(data, k)["observation"][0].tolist()) for data in (zero, one) for k in range(TRIALS)
    ]
    assert len(set(starts)) == len(starts)
    assert same(zero, collect(build(kind, seed=0)))


def test_set_seed_starts_again(kind):
    collector, other = build(kind, seed=0), build(kind, seed=8)
    set_weights(collector, other.policy[0].weight.detach())
    collector.collect()
    assert collector.set_seed(8) == 9
    for _ in range(2):
        assert same(collect(collector), collect(other))
    assert collector.set_seed(8, static_seed=True) == 8
    assert collector.set_seed(0) == 1
    with pytest.raises(ValueError, match=r"^seed"):
        collector.set_seed(-1)


def test_a_state_dict_goes_on_where_it_was_taken(kind):
    collector = build(kind, DecayingEpsilonGreedy(0.9), seed=2)
    set_weights(collector, torch.randn(TRIALS, 2, 4, generator=torch.Generator().manual_seed(0)))
    for active in ([True] * 4, [True, True, False, True]):
        collector.collect(np.array(active))
        collector.strategy.step()
    state = {
        key: value.clone() if isinstance(value, torch.Tensor) else value
        for key, value in collector.state_dict().items()
    }
    expected = [collect(collector) for _ in range(2)]
    other = build(kind, DecayingEpsilonGreedy(0.9), seed=77)
    other.collect()
    other.load_state_dict(state)
    assert int(other.strategy.iteration) == 2
    assert [same(collect(other), data) for data in expected] == [True, True]
    assert other.frames == collector.frames


def test_a_state_dict_is_a_snapshot(kind):
    collector = build(kind)
    collector.collect()
    episodes = collector.state_dict()["episodes"]
    collector.collect()
    assert episodes.tolist() == [1] * TRIALS


def test_iteration_ends_at_total_frames(kind):
    collector = build(kind)
    counts = [len(collector.collect().frames) for _ in range(4)]
    collector = build(kind, total_frames=counts[0] + counts[1] + 1)
    delivered = [len(data) for data in collector]
    assert delivered == counts[:3]
    assert collector.frames == sum(counts[:3])
    exact = build(kind, total_frames=counts[0] + counts[1])
    assert [len(data) for data in exact] == counts[:2]


def test_iteration_without_a_limit_goes_on(kind):
    collector = build(kind)
    for count, _ in zip(range(1, 6), collector, strict=False):
        assert collector.episodes.tolist() == [count] * TRIALS


def test_shutdown_closes_the_environment(kind):
    collector = build(kind)
    collector.collect()
    collector.shutdown()
    assert collector.env.is_closed
    collector.shutdown()  # again is no error
    kept = build(kind)
    kept.collect()
    kept.shutdown(close_env=False)
    assert not kept.env.is_closed


def test_it_is_a_torchrl_collector_whose_repr_names_what_it_collects(kind):
    assert issubclass(kind, EpisodeCollector)
    assert issubclass(kind, BaseCollector)
    assert repr(build(kind)) == f"{kind.__name__}(env=CartPole-v1, trials=4)"


@pytest.mark.parametrize("active", [[True] * 3, [[True] * 4], [False] * 4, []])
def test_a_wrong_active_is_refused(kind, active):
    with pytest.raises(ValueError, match=r"^active.*bool.*\[4\]"):
        build(kind).collect(np.array(active, dtype=np.bool_))


def test_a_policy_without_a_strategy_is_refused(kind):
    env = make_env("CartPole-v1", TRIALS)
    last = TensorDictModule(torch.nn.Identity(), ["logits"], ["action"])
    with pytest.raises(ValueError, match=r"TensorDictSequential\(policy, strategy\)"):
        kind(env, TensorDictSequential(LinearPolicy(env), last))


def test_a_parameter_per_trial_must_fit_the_trials(kind):
    with pytest.raises(ValueError, match=r"3 values.*4 trials"):
        build(kind, EpsilonGreedy([0.1, 0.2, 0.3]))


def test_another_environment_is_refused(kind):
    from torchrl.envs import GymEnv

    env = make_env("CartPole-v1", TRIALS)
    with pytest.raises(ValueError, match="lanes"):
        kind(GymEnv("CartPole-v1"), TensorDictSequential(LinearPolicy(env), Softmax()))
