"""The episodes of every collector (``kind``, in conftest.py)."""

from __future__ import annotations

from functools import reduce
from operator import add

import gymnasium as gym
import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictSequential
from torchrl.envs.utils import ExplorationType

from trl_explore.collectors import (
    EpisodeCollector,
)
from trl_explore.envs import make_env
from trl_explore.envs.kernels import register_kernel
from trl_explore.envs.kernels.tables import TableEnv, from_table
from trl_explore.numerics.streams import Stream, generator
from trl_explore.policies import LinearPolicy
from trl_explore.strategies import (
    Argmax,
    DecayingEpsilonGreedy,
    EpsilonGreedy,
    Random,
    Softmax,
    inverse_cdf,
)

STRATEGIES = [
    Random,
    Argmax,
    EpsilonGreedy,
    DecayingEpsilonGreedy,
    Softmax,
    lambda: Softmax(temperature=[0.3, 1.0, 2.0, 4.0]),
]
TRIALS = 4


def build(
    kind, strategy=None, trials=TRIALS, *, seed=0, first_trial=0, max_steps=500, **options
) -> EpisodeCollector:
    torch.set_num_threads(1)
    env = make_env("CartPole-v1", trials, max_steps, seed=seed, first_trial=first_trial)
    policy = LinearPolicy(env, seed=seed, first_trial=first_trial)
    strategy = Softmax() if strategy is None else strategy
    return kind(env, TensorDictSequential(policy, strategy), **options)


def collect(collector, *active: bool) -> dict[str, torch.Tensor]:
    """A copy of the frames: the collector may reuse its memory. Flat names."""
    data = collector.collect(np.array(active) if active else None).frames
    return {
        name: value.clone() for name, value in data.flatten_keys(".").items() if value is not None
    }


def same(one: dict[str, torch.Tensor], two: dict[str, torch.Tensor]) -> bool:
    return one.keys() == two.keys() and all(torch.equal(one[name], two[name]) for name in one)


def of(data: dict[str, torch.Tensor], trial: int) -> dict[str, torch.Tensor]:
    """One trial's frames, without the number of its row."""
    rows = data["trial"] == trial
    return {name: value[rows] for name, value in data.items() if name != "trial"}


def set_weights(collector, weight: torch.Tensor) -> None:
    with torch.no_grad():
        collector.policy[0].weight.copy_(weight)


def test_entries(kind):
    collector = build(kind)
    data = collector.collect().frames
    frames = len(data)
    assert data.batch_size == (frames,)
    expected = {
        "trial": ((frames,), torch.int64),
        "observation": ((frames, 4), torch.float32),
        "action": ((frames,), torch.int64),
        "action_log_prob": ((frames,), torch.float32),
        "next.reward": ((frames, 1), torch.float32),
        "next.done": ((frames, 1), torch.bool),
        "next.terminated": ((frames, 1), torch.bool),
        "next.truncated": ((frames, 1), torch.bool),
        "next.step_count": ((frames, 1), torch.int64),
        "next.episode_reward": ((frames, 1), torch.float32),
    }
    flat = data.flatten_keys(".")
    assert {name: (tuple(v.shape), v.dtype) for name, v in flat.items()} == expected
    assert not any(value.requires_grad for value in flat.values())


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_one_whole_episode_of_every_active_trial(kind, strategy):
    collector = build(kind, strategy(), max_steps=40)
    for active in ([True] * 4, [True, False, True, True], [False, False, False, True]):
        data = collect(collector, *active)
        trial, done = data["trial"], data["next.done"][:, 0]
        assert trial.unique().tolist() == np.flatnonzero(active).tolist()
        assert (trial.diff() >= 0).all()  # contiguous and ascending
        ends = done.nonzero()[:, 0]
        assert trial[ends].tolist() == np.flatnonzero(active).tolist()
        lengths = trial.unique(return_counts=True)[1]
        assert torch.equal(ends, lengths.cumsum(0) - 1)  # each ends with done, and only there
        assert torch.equal(data["next.step_count"][ends, 0], lengths)
        assert torch.equal(data["next.done"], data["next.terminated"] | data["next.truncated"])
        for k in np.flatnonzero(active).tolist():
            episode = of(data, k)
            length = len(episode["action"])
            assert episode["next.step_count"][:, 0].tolist() == list(range(1, length + 1))
            total = episode["next.reward"].cumsum(0)
            assert torch.equal(episode["next.episode_reward"], total)
            assert episode["next.truncated"][-1].item() == (length == 40)


@pytest.mark.parametrize("k", [1, 3])
def test_the_outcome_of_every_episode(kind, k):
    """Score and length are those of the frames, which are whole episodes and nothing else."""
    collector = build(kind, max_steps=30, episodes_per_update=k)
    for active in ([True] * 4, [False, True, True, False]):
        frames, score, length = collector.collect(np.array(active))
        n = sum(active)
        assert score.shape == length.shape == ((n,) if k == 1 else (n, k))
        assert (score.dtype, length.dtype) == (np.float64, np.int64)
        after = frames["next"]
        ends = after["done"].squeeze(-1).nonzero()[:, 0]
        assert (ends + 1).tolist() == length.reshape(-1).cumsum().tolist()
        assert int(ends[-1]) + 1 == len(frames)
        assert after["step_count"][ends, 0].tolist() == length.reshape(-1).tolist()
        assert after["episode_reward"][ends, 0].tolist() == score.reshape(-1).tolist()
        owners = np.repeat(np.flatnonzero(active), length.reshape(n, -1).sum(1))
        assert frames["trial"].tolist() == owners.tolist()


class Payments(TableEnv):
    """Pays ``pay`` at every step; of FrozenLake's size, whose compiled code it shares."""

    def __init__(self, pay: float) -> None:
        stays = {s: {a: [(1.0, s, pay, False)] for a in range(4)} for s in range(16)}
        super().__init__(stays, start=0, shape=(4, 4))


register_kernel(Payments)(from_table)


@pytest.mark.parametrize(
    ("pay", "steps"), [(0.1, 100), (20_000_001.0, 3), (0.01, 1000)], ids=["0.1", "large", "0.01"]
)
def test_a_score_is_a_sum_in_double(kind, pay, steps):
    """In single precision, a hundred rewards of 0.1 exceed 10, and 3 x 20,000,001 is 60,000,000."""
    gym.register("Payments-v0", entry_point=Payments)
    try:
        env = make_env("Payments-v0", 2, steps, kwargs={"pay": pay})
        collector = kind(env, TensorDictSequential(LinearPolicy(env), Softmax()))
        assert collector.collect().score.tolist() == [reduce(add, [pay] * steps)] * 2
    finally:
        gym.registry.pop("Payments-v0")


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("k", [1, 2])
def test_played_episodes_are_those_that_would_be_collected(kind, strategy, k):
    """In any order, several of one trial, without a change of the counters."""
    collector = build(kind, strategy(), max_steps=60)
    collected = [collector.collect() for _ in range(3)]
    played = build(kind, strategy(), max_steps=60, episodes_per_update=k)
    trials, episodes = np.array([2, 0, 2, 3, 2]), np.array([1, 0, 2, 1, 0])
    score, length = played.play(trials, episodes)
    assert score.tolist() == [collected[e].score[t] for t, e in zip(trials, episodes, strict=True)]
    assert length.tolist() == [
        collected[e].length[t] for t, e in zip(trials, episodes, strict=True)
    ]
    assert played.frames == 0
    assert (played.episodes == 0).all()
    assert played.episodes_per_update == k
    assert len(played.play(np.empty(0, np.int64), np.empty(0, np.int64))[0]) == 0


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_every_frame_is_the_episode_of_its_stream(kind, strategy):
    """Noise, action, log-probability, dynamics, reward and flags, replayed one by one."""
    seed, first_trial = 5, 3
    strategy = strategy()
    collector = build(kind, strategy, seed=seed, first_trial=first_trial, max_steps=60)
    for episode in range(3):
        data = collect(collector)
        for k in range(TRIALS):
            mine = of(data, k)
            stream = (first_trial + k, episode)
            other = gym.make("CartPole-v1", max_episode_steps=60)
            other.unwrapped.np_random = generator(seed, Stream.ENVIRONMENT, *stream)
            noise = torch.from_numpy(
                generator(seed, Stream.ACTION, *stream).random(len(mine["action"]))
            )
            logits = mine["observation"] @ collector.policy[0].weight[k].detach().t()
            rows = torch.full((len(logits),), k)
            probs = strategy.probs(logits, rows)
            drawn = probs.gather(1, mine["action"].unsqueeze(1)).squeeze(1)
            assert (drawn > 0).all()
            torch.testing.assert_close(mine["action_log_prob"], drawn.log(), rtol=1e-4, atol=1e-5)
            assert torch.equal(mine["action"], inverse_cdf(probs, noise))
            observation = other.reset()[0]
            for t, action in enumerate(mine["action"].tolist()):
                np.testing.assert_allclose(
                    mine["observation"][t].numpy(), observation, rtol=1e-4, atol=1e-5
                )
                observation, reward, terminated, truncated, _ = other.step(action)
                assert mine["next.reward"][t].item() == reward
                assert mine["next.terminated"][t].item() == terminated
                assert mine["next.truncated"][t].item() == truncated
        strategy.step()


def test_long_episodes_use_fresh_noise_to_their_end(kind):
    """Episodes that reach 500 steps: the noise does not repeat, whatever its block size."""
    collector = build(kind, EpsilonGreedy(0.1), trials=2)
    # Pushing towards the side where the pole falls keeps it up.
    push = torch.tensor([0.05, 0.5, 3.0, 1.0]) * 10
    set_weights(collector, torch.stack([-push, push]).expand(2, 2, 4))
    data = collect(collector)
    for k in range(2):
        mine = of(data, k)
        length = len(mine["action"])
        assert length > 300
        noise = torch.from_numpy(generator(0, Stream.ACTION, k, 0).random(length))
        logits = mine["observation"] @ collector.policy[0].weight[k].detach().t()
        probs = EpsilonGreedy(0.1).probs(logits)
        assert torch.equal(mine["action"], inverse_cdf(probs, noise))


def test_parameters_are_those_at_the_start_of_the_episode(kind):
    """Changing weights or ε between two calls changes all of the next frames, and only them."""
    strategy = DecayingEpsilonGreedy(0.5)
    collector = build(kind, strategy)
    push = torch.tensor([[0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    for i, sign in enumerate((1.0, -1.0, 1.0, -1.0)):
        set_weights(collector, (sign * push).expand(TRIALS, 2, 4))
        data = collect(collector)
        greedy = (data["observation"][:, 2] * sign > 0).long()
        epsilon = 0.5**i
        expected = torch.where(data["action"] == greedy, 1 - epsilon / 2, epsilon / 2).log()
        torch.testing.assert_close(data["action_log_prob"], expected)
        assert int(strategy.iteration) == i  # the schedule is the trainer's to advance
        strategy.step()


def test_collecting_changes_no_parameter(kind):
    collector = build(kind)
    before = collector.policy[0].weight.detach().clone()
    collector.collect()
    assert torch.equal(collector.policy[0].weight, before)
    assert collector.policy[0].weight.grad is None


def test_stopped_trials_are_absent_and_wait(kind):
    collector, undisturbed = build(kind), build(kind)
    everything = [collect(undisturbed) for _ in range(3)]
    first = collect(collector)
    for _ in range(2):
        part = collect(collector, True, False, True, False)
        assert part["trial"].unique().tolist() == [0, 2]
    last = collect(collector)
    assert same(first, everything[0])
    assert collector.episodes.tolist() == [4, 2, 4, 2]
    for k in (0, 2):
        assert same(of(part, k), of(everything[2], k))
    for k in (1, 3):
        assert same(of(last, k), of(everything[1], k))


def test_an_environment_that_was_used_before(kind):
    """What somebody else began in a lane is no part of the data."""
    collector = build(kind)
    collector.env.rollout(2)
    collector.env.reset()
    part = collect(collector, False, True, False, False)
    assert part["trial"].unique().tolist() == [1]
    assert same(of(part, 1), of(collect(build(kind)), 1))


def test_a_trial_is_the_same_wherever_it_stands(kind):
    together = build(kind, trials=9, seed=3)
    batches = [collect(together) for _ in range(2)]
    for k in (0, 4, 8):
        alone = build(kind, trials=1, seed=3, first_trial=k)
        for batch in batches:
            assert same(of(collect(alone), 0), of(batch, k))


def test_a_trial_does_not_feel_a_broken_neighbour(kind):
    sound, broken = build(kind), build(kind)
    with torch.no_grad():
        broken.policy[0].weight[1] = torch.nan
    one, two = collect(sound), collect(broken)
    for k in (0, 2, 3):
        assert same(of(one, k), of(two, k))


@pytest.mark.parametrize("mode", ["MODE", "MEAN", "DETERMINISTIC"])
def test_without_exploration_the_policy_decides(kind, mode):
    collector = build(kind, Random(), exploration_type=ExplorationType[mode])
    data = collect(collector)
    weight = collector.policy[0].weight.detach()[data["trial"]]
    logits = (weight @ data["observation"].unsqueeze(-1)).squeeze(-1)
    assert torch.equal(data["action"], logits.argmax(-1))
    assert (data["action_log_prob"] == 0).all()


def test_exploration_is_the_default(kind):
    data = collect(build(kind, Random()))
    torch.testing.assert_close(
        data["action_log_prob"], torch.full_like(data["action_log_prob"], -np.log(2))
    )
