"""Episodes are a function of seed, trial and episode, whatever an environment draws from."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import seeding

from trl_explore.envs import LaneVectorEnv
from trl_explore.envs.seeding import GYMNASIUM, Source
from trl_explore.numerics.streams import Stream, generator


class Drawing(gym.Env):
    """Observes three random numbers; ends at random."""

    observation_space = spaces.Box(0, 1, (3,), np.float32)
    action_space = spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.draw(), {}

    def step(self, action):
        numbers = self.draw()
        return numbers, float(numbers[0]), bool(numbers[1] > 0.8), False, {}

    def draw(self):
        return self.np_random.random(3).astype(np.float32)


class OnlySeeded(Drawing):
    """A generator of its own, made only if there is a seed."""

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            self.own = np.random.default_rng(seed)
        return self.draw(), {}

    def draw(self):
        return self.own.random(3).astype(np.float32)


class NoSuper(Drawing):
    """Uses ``np_random`` and never seeds it."""

    def reset(self, *, seed=None, options=None):
        return self.draw(), {}


class Bound(Drawing):
    """Keeps the first generator that it gets."""

    def reset(self, *, seed=None, options=None):
        super(Drawing, self).reset(seed=seed)
        self.own = getattr(self, "own", self.np_random)
        return self.draw(), {}

    def draw(self):
        return self.own.random(3).astype(np.float32)


class ReadOnly(OnlySeeded):
    """A property without a setter."""

    np_random = property(lambda self: self.own)  # pyright: ignore


class FromSpace(Drawing):
    """Samples a space of its class, which it seeds with entropy."""

    def reset(self, *, seed=None, options=None):
        super(Drawing, self).reset(seed=seed)
        self.observation_space.seed()
        return self.draw(), {}

    def draw(self):
        return self.observation_space.sample()


class Utility(Drawing):
    """Makes its generator with gymnasium's function."""

    def reset(self, *, seed=None, options=None):
        self.own, _ = seeding.np_random(seed)
        return self.draw(), {}

    draw = Bound.draw


KINDS = (Drawing, OnlySeeded, NoSuper, Bound, ReadOnly, FromSpace, Utility)


@pytest.fixture(params=KINDS, ids=lambda kind: kind.__name__)
def drawing(request, monkeypatch):
    spec = EnvSpec("Drawing-v0", request.param, max_episode_steps=6)
    monkeypatch.setitem(gym.registry, "Drawing-v0", spec)
    return "Drawing-v0"


def episodes(id: str, n: int, first_trial: int = 0, seed: int = 3, start: int = 0, **options):
    """The observations of two episodes of n trials: {(trial, episode): [[...], ...]}."""
    lanes = LaneVectorEnv(id, n, seed=seed, first_trial=first_trial, **options)
    lanes.episodes[:] = start
    found: dict[tuple[int, int], list[list[float]]] = {}
    for episode in (start, start + 1):
        seen = [lanes.reset()[0]]
        length = np.ones(n, int)
        while lanes.running.any():
            length += lanes.running
            seen.append(lanes.step(np.zeros(n, int))[0])
        for k in range(n):
            rows = np.stack(seen)[: length[k], k].tolist()
            found[first_trial + k, episode] = rows
    lanes.close()
    return found


def test_an_episode_is_the_same_in_every_run_and_company(drawing):
    all_trials = episodes(drawing, 4)
    assert episodes(drawing, 4) == all_trials
    alone = episodes(drawing, 1, first_trial=2)
    assert alone == {place: all_trials[place] for place in alone}
    later = episodes(drawing, 2, start=1)  # a run that is continued
    for k in range(2):
        assert later[k, 1] == all_trials[k, 1]
    assert len({str(rows) for rows in all_trials.values()}) == len(all_trials)
    assert episodes(drawing, 4, seed=4) != all_trials


def test_np_random_is_the_stream_that_kernels_use(monkeypatch):
    spec = EnvSpec("Drawing-v0", Drawing, max_episode_steps=6)
    monkeypatch.setitem(gym.registry, "Drawing-v0", spec)
    for (trial, episode), rows in episodes("Drawing-v0", 3, first_trial=5).items():
        draws = generator(3, Stream.ENVIRONMENT, trial, episode)
        for row in rows:
            assert row == draws.random(3).astype(np.float32).tolist()


def test_the_seed_of_a_reset():
    env = OnlySeeded()
    source = Source(env)
    seeds = set()
    for trial in range(3):
        for episode in range(3):
            env.reset = lambda *, seed, options=None: seed  # pyright: ignore
            seeds.add(source.reset(7, Stream.ENVIRONMENT, trial, episode))
            counter = np.array([0, 1, episode, trial], np.uint64)
            bits = generator(7, Stream.ENVIRONMENT, 0).bit_generator
            bits.state = {**bits.state, "state": {**bits.state["state"], "counter": counter}}
            assert int(bits.random_raw()) >> 33 in seeds
    assert len(seeds) == 9
    assert all(type(seed) is int and 0 <= seed < 2**31 for seed in seeds)


def test_gymnasium_gets_its_function_back():
    class Failing(Drawing):
        def reset(self, *, seed=None, options=None):
            raise OSError("no disk")

    with pytest.raises(OSError, match="no disk"):
        Source(Failing()).reset(0, Stream.ENVIRONMENT, 0, 0)
    assert seeding.np_random is GYMNASIUM


def test_a_space_of_the_class_is_not_shared():
    one, two = FromSpace(), FromSpace()
    sources = [Source(one), Source(two)]
    assert one.observation_space is not two.observation_space
    first = [source.reset(0, Stream.ENVIRONMENT, k, 0)[0] for k, source in enumerate(sources)]
    assert (first[0] != first[1]).any()
