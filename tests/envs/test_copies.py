"""What an environment returns is checked, and what it raises is placed."""

from __future__ import annotations

import asyncio
import signal
from fractions import Fraction

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from trl_explore.envs import LaneVectorEnv
from trl_explore.envs.copies import EnvError


class SilentError(Exception):
    """Neither it nor its message can be shown."""

    def __repr__(self):
        raise RuntimeError

    __str__ = __repr__


GOOD = (np.zeros(3, np.float32), 1.0, False, False, {})


class Odd(gym.Env):
    """In its second episode, the second step does what the test has set."""

    observation_space = spaces.Box(-np.inf, np.inf, (3,), np.float32)
    action_space = spaces.Discrete(2)
    step_answer = staticmethod(lambda: GOOD)
    reset_answer = staticmethod(lambda: (GOOD[0], {}))

    def __init__(self) -> None:
        self.resets = 0

    def reset(self, *, seed=None, options=None):
        self.resets, self.steps = self.resets + 1, 0
        return self.reset_answer() if self.resets == 2 else (GOOD[0], {})

    def step(self, action):
        self.steps += 1
        return self.step_answer() if (self.resets, self.steps) == (2, 2) else GOOD


@pytest.fixture
def odd(monkeypatch):
    monkeypatch.setitem(gym.registry, "Odd-v0", EnvSpec("Odd-v0", Odd, max_episode_steps=5))
    return "Odd-v0"


def play(id: str) -> LaneVectorEnv:
    """Two episodes of two steps in the trials 6 and 7."""
    lanes = LaneVectorEnv(id, 2, first_trial=6)
    for _ in range(2):
        lanes.reset()
        for _ in range(2):
            lanes.step(np.zeros(2, np.int64))
    return lanes


def answer(**changes):
    names = ("observation", "reward", "terminated", "truncated", "info")
    return tuple(changes.get(name, value) for name, value in zip(names, GOOD, strict=True))


WRONG = {
    "observation of shape (2,)": {"observation": np.zeros(2, np.float32)},
    "observation of shape (1,)": {"observation": np.zeros(1, np.float32)},
    "observation of shape (1, 3)": {"observation": np.zeros((1, 3), np.float32)},
    "observation of shape ()": {"observation": 0.5},
    "observation = array(['1', '2', '3']": {"observation": np.array(["1", "2", "3"])},
    "observation = array([1, 2, None]": {"observation": np.array([1, 2, None], object)},
    "observation = None": {"observation": None},
    "observation = [[1], [2, 3]]": {"observation": [[1], [2, 3]]},
    "observation[0] = inf": {"observation": np.array([1e300, 0, 0])},
    "observation[2] = nan": {"observation": np.array([0, 0, np.nan], np.float32)},
    "reward array([1.])": {"reward": np.array([1.0])},
    "reward None": {"reward": None},
    "reward '1.5'": {"reward": "1.5"},
    "reward a SilentError, which is not a number": {"reward": SilentError()},
    "observation = a SilentError, which is not": {"observation": SilentError()},
    "terminated = array(True)": {"terminated": np.array(True)},
    "reward (1+2j)": {"reward": 1 + 2j},
    "reward tensor(1.)": {"reward": torch.tensor(1.0)},
    "reward masked": {"reward": np.ma.masked},
    "reward nan": {"reward": float("nan")},
    "reward inf": {"reward": 10**400},
    "reward -inf": {"reward": np.float32(-np.inf)},
    "reward 1e+300, which is not within ±1e+30": {"reward": 1e300},
    "terminated = 'False', which is not a bool": {"terminated": "False"},
    "terminated = nan": {"terminated": float("nan")},
    "terminated = None": {"terminated": None},
    "terminated = 1": {"terminated": 1},
    "terminated = array([ True])": {"terminated": np.array([True])},
    "terminated = {'__all__': False}": {"terminated": {"__all__": False}},
    "truncated = 'False'": {"truncated": "False"},
    "info of type NoneType": {"info": None},
    "an action mask, but had none": {"info": {"action_mask": np.ones(2)}},
}


@pytest.mark.parametrize("message", WRONG)
def test_a_wrong_value_is_one_line_with_its_place(message, odd, monkeypatch):
    monkeypatch.setattr(Odd, "step_answer", staticmethod(lambda: answer(**WRONG[message])))
    with pytest.raises(EnvError) as raised:
        play(odd)
    line = str(raised.value)
    assert line.startswith(f"environment 'Odd-v0' returned {message}") or (
        line.startswith(f"environment 'Odd-v0' returned the {message}")
    )
    assert line.endswith("in episode 1 of trial 6")
    assert "\n" not in line


RIGHT = {
    "list": ({"observation": [1, 2, 3]}, "observation", [1, 2, 3]),
    "float64": ({"observation": np.array([1.0, 2.0, 3.0])}, "observation", [1, 2, 3]),
    "integers": ({"observation": np.array([1, 2, 3])}, "observation", [1, 2, 3]),
    "int": ({"reward": 3}, "reward", 3),
    "numpy": ({"reward": np.float32(0.5)}, "reward", 0.5),
    "zero-dimensional": ({"reward": np.array(2.5)}, "reward", 2.5),
    "fraction": ({"reward": Fraction(1, 2)}, "reward", 0.5),
    "true": ({"reward": True}, "reward", 1),
    "numpy true": ({"reward": np.bool_(True)}, "reward", 1),
    "half": ({"reward": np.float16(0.5)}, "reward", 0.5),
    "other byte order": ({"observation": np.arange(3, dtype=">f4")}, "observation", [0, 1, 2]),
    "every second": ({"observation": np.arange(6, dtype="f4")[::2]}, "observation", [0, 2, 4]),
    "numpy bool": ({"terminated": np.bool_(True)}, "terminated", True),
    "truncated": ({"truncated": np.bool_(True)}, "truncated", True),
}


@pytest.mark.parametrize("name", RIGHT)
def test_values_that_lose_nothing_are_taken(name, odd, monkeypatch):
    changes, signal, expected = RIGHT[name]
    monkeypatch.setattr(Odd, "step_answer", staticmethod(lambda: answer(**changes)))
    assert getattr(play(odd).outputs, signal)[0].tolist() == expected


@pytest.mark.parametrize(
    ("method", "returned", "message"),
    [
        ("step", GOOD[:4], r"4 values \(ndarray, float, bool, bool\) from step \(the old gym API"),
        ("step", (*GOOD, {}), "6 values .* from step; it must return observation, reward, term"),
        ("step", None, "one NoneType from step; it must return observation, reward"),
        ("reset", GOOD[0], "one ndarray from reset .*old gym API.*must return observation, info"),
        ("reset", (GOOD[0], 3), r"2 values \(ndarray, int\) from reset .*observation, info"),
        ("reset", np.zeros(2, np.float32), "one ndarray from reset"),
    ],
)
def test_old_interfaces_are_named(method, returned, message, odd, monkeypatch):
    monkeypatch.setattr(Odd, f"{method}_answer", staticmethod(lambda: returned))
    with pytest.raises(EnvError, match=f"'Odd-v0' returned {message}.* in episode 1 of trial 6$"):
        play(odd)


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (RuntimeError("the simulator\nlost its licence"), ": the simulator lost its licence"),
        (SystemExit(3), ": 3"),
        (OSError(28, "No space left", "simulator.db"), r": \[Errno 28\].*simulator.db'"),
        (AssertionError(), ""),
        (StopIteration(), ""),
        (MemoryError(), ""),
        (ValueError("x"), ": x"),
        (ValueError("x" * 10**6), ": x{1000}"),
        (asyncio.CancelledError(), ""),  # no Exception
        (GeneratorExit(), ""),
        (SilentError(), ""),
    ],
)
@pytest.mark.parametrize("method", ["step", "reset"])
def test_an_error_is_placed(method, error, message, odd, monkeypatch):
    def fail():
        raise error

    monkeypatch.setattr(Odd, f"{method}_answer", staticmethod(fail))
    name = type(error).__name__
    place = f"^environment 'Odd-v0' raised {name} in episode 1 of trial 6{message}$"
    with pytest.raises(EnvError, match=place) as raised:
        play(odd)
    assert raised.value.__cause__ is error  # for the traceback


def test_closing_goes_on_after_an_error(odd, monkeypatch, caplog):
    def fail(env):
        closed.append(env)
        raise OSError("the window is gone")

    closed: list[Odd] = []
    lanes = play(odd)
    monkeypatch.setattr(Odd, "close", fail)
    lanes.close()
    assert len(closed) == 2
    line = "environment 'Odd-v0' raised OSError: the window is gone when it was closed"
    assert caplog.messages == [line, line]


@pytest.mark.parametrize(
    ("name", "space", "message"),
    [
        (
            "action_space",
            spaces.Discrete,
            r"Discrete\(3\) in one trial and Discrete\(2\) in an",
        ),
        (
            "observation_space",
            lambda n: spaces.Box(-1, 1, (n + 1,)),
            "observations of 4 numbers in one trial and of 3 in another",
        ),
    ],
)
def test_other_spaces_in_another_trial(name, space, message, odd, monkeypatch):
    """A policy has one number of inputs and of actions."""

    def build(self):
        self.resets = 0
        numbers.append(2 + len(numbers) // 2)  # the first copy and the probe are alike
        setattr(self, name, space(numbers[-1]))

    numbers: list[int] = []
    monkeypatch.setattr(Odd, "__init__", build)
    with pytest.raises(EnvError, match=message):
        play(odd)


def test_a_copy_that_cannot_be_built_is_placed(odd, monkeypatch):
    def build(self):
        self.resets = 0
        built.append(self)
        if len(built) > 2:  # one copy is a probe
            raise RuntimeError("no more licences")

    built: list[Odd] = []
    monkeypatch.setattr(Odd, "__init__", build)
    line = r"'Odd-v0' .*RuntimeError: no more licences, when it was built for trial 7$"
    with pytest.raises(EnvError, match=line):
        play(odd)


def test_ctrl_c_is_no_error_of_the_environment(odd, monkeypatch):
    def interrupt():
        raise KeyboardInterrupt

    monkeypatch.setattr(Odd, "step_answer", staticmethod(interrupt))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            play(odd)
        signal.signal(signal.SIGINT, lambda *_: None)  # as the command does
        with pytest.raises(EnvError, match=r"raised KeyboardInterrupt in episode 1 of trial 6$"):
            play(odd)
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("limit", [1, 3])
def test_the_time_limit(limit, odd):
    lanes = LaneVectorEnv(odd, 1, limit)
    for _ in range(3):
        lanes.reset()
        cuts = [bool(lanes.step(np.zeros(1, int))[3][0]) for _ in range(limit)]
        assert cuts == [False] * (limit - 1) + [True]
        assert not lanes.running[0]
