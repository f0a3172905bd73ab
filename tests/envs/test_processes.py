"""Lanes that are stepped in processes of their own: the same lanes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from trl_explore.envs.copies import EnvError
from trl_explore.envs.processes import processors
from trl_explore.envs.vector import LaneVectorEnv

ROOT = Path(__file__).resolve().parents[2]


def all_children() -> list[int]:
    text = Path(f"/proc/self/task/{os.getpid()}/children").read_text(encoding="utf-8")
    return [int(pid) for pid in text.split()]


@pytest.fixture
def children() -> Callable[[], list[int]]:
    """The processes that the test has started and that are still there."""
    before = all_children()
    return lambda: [pid for pid in all_children() if pid not in before]


def walk(workers: int, id: str, n: int, **kwargs) -> list[tuple[np.ndarray, ...]]:
    """Everything that n lanes say in three episodes, some lanes being reset at other times."""
    lanes = LaneVectorEnv(id, n, 12, seed=3, first_trial=4, workers=workers, **kwargs)
    draws = np.random.default_rng(0)
    space = lanes.single_action_space
    seen = []
    for episode in range(3):
        mask = draws.random(n) < 0.7 if episode else np.ones(n, dtype=bool)
        observation, info = lanes.reset(options={"reset_mask": mask})
        seen.append((observation, *info.values()))
        for _ in range(9 if episode == 1 else 12):
            if isinstance(space, gym.spaces.Discrete):
                actions = draws.integers(space.n, size=n)
            else:
                actions = draws.uniform(-3, 3, (n, *space.shape))
            *signals, info = lanes.step(actions)
            seen.append((*signals, *info.values()))
    lanes.close()
    return seen


@pytest.mark.parametrize("id", ["CartPole-v1", "Taxi-v4", "Pendulum-v1", "FrozenLake-v1"])
def test_nothing_depends_on_the_number_of_processes(id):
    reference = walk(1, id, 5)
    for workers in (2, 3):
        for ours, theirs in zip(walk(workers, id, 5), reference, strict=True):
            assert len(ours) == len(theirs)
            for a, b in zip(ours, theirs, strict=True):
                np.testing.assert_array_equal(a, b)
                assert a.dtype == b.dtype


def test_attributes_reach_the_processes():
    heavy = [walk(w, "CartPole-v1", 2, attributes={"gravity": 30.0})[5][0] for w in (1, 2)]
    np.testing.assert_array_equal(*heavy)
    assert (heavy[0] != walk(1, "CartPole-v1", 2)[5][0]).any()


def test_how_many_processes():
    assert LaneVectorEnv("CartPole-v1", 500, workers=None).workers == min(125, processors())
    assert LaneVectorEnv("CartPole-v1", 7, workers=None).workers == 1  # too few to divide
    assert LaneVectorEnv("CartPole-v1", 3, workers=7).workers == 3
    assert LaneVectorEnv("CartPole-v1", 3).workers == 1
    assert 1 <= processors() <= os.cpu_count()


def test_processes_are_started_only_when_lanes_are_stepped(children):
    """A collector that compiles the environment needs none."""
    lanes = LaneVectorEnv("CartPole-v1", 4, workers=3)
    assert not children()
    lanes.reset()
    assert len(children()) == 2  # beside this one
    lanes.close()
    assert not children()


def test_a_process_that_was_killed_is_one_clear_line(children):
    lanes = LaneVectorEnv("CartPole-v1", 4, workers=2)
    lanes.reset()
    os.kill(children()[0], signal.SIGKILL)
    with pytest.raises(
        RuntimeError,
        match=r"'CartPole-v1'.*process.*-9",
    ):
        lanes.step(np.zeros(4, np.int64))
    assert not children()
    lanes.reset()  # starts the processes again
    lanes.close()


MODULE = """
import os
import gymnasium as gym
import numpy as np

class Noisy(gym.Env):
    observation_space = gym.spaces.Box(-1, 1, (1,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def __init__(self, main=0):
        self.fails = main and main != os.getpid()

    def reset(self, *, seed=None, options=None):
        print("a line on standard output", flush=True)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        if self.fails:
            raise OverflowError("the engine\\nexploded")
        return np.zeros(1, np.float32), 1.0, False, False, {}

gym.register("Noisy-v0", Noisy, max_episode_steps=5)
"""


@pytest.fixture
def noisy(tmp_path, monkeypatch):
    (tmp_path / "noisy_module.py").write_text(MODULE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    yield "noisy_module:Noisy-v0"
    gym.registry.pop("Noisy-v0", None)
    sys.modules.pop("noisy_module", None)


def test_what_an_environment_prints_is_not_taken_for_an_answer(noisy, capfd):
    lanes = LaneVectorEnv(noisy, 2, workers=2)
    lanes.reset()
    assert lanes.step(np.zeros(2, np.int64))[1].tolist() == [1, 1]
    lanes.close()
    assert capfd.readouterr().err.count("a line on standard output") == 1


def test_an_error_in_a_process_is_one_clear_line(noisy, children):
    lanes = LaneVectorEnv(noisy, 2, workers=2, kwargs={"main": os.getpid()})
    lanes.reset()
    with pytest.raises(
        EnvError,
        match=r"'noisy_module:Noisy-v0' raised OverflowError in episode 0 of trial 1: the eng",
    ):
        lanes.step(np.zeros(2, np.int64))
    assert not children()


class Local(gym.Env):
    """An environment that another process cannot import."""

    observation_space = gym.spaces.Box(-1, 1, (1,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        return np.zeros(1, np.float32), {}


def test_an_environment_that_cannot_be_sent_is_one_clear_line(monkeypatch, children):
    class Inner(Local):
        pass

    spec = gym.envs.registration.EnvSpec("Local-v0", Inner, max_episode_steps=5)
    monkeypatch.setitem(gym.registry, "Local-v0", spec)
    lanes = LaneVectorEnv("Local-v0", 2, workers=2)
    with pytest.raises(ValueError, match=r"process.*workers=1$"):
        lanes.reset()
    assert not children()


def test_no_process_outlives_the_main_one():
    """Not even one that is killed."""
    script = (
        "from pathlib import Path; import os, time; from trl_explore.envs import LaneVectorEnv\n"
        "lanes = LaneVectorEnv('CartPole-v1', 3, workers=3); lanes.reset()\n"
        "print(Path(f'/proc/self/task/{os.getpid()}/children').read_text(), flush=True)\n"
        "time.sleep(60)"
    )
    main = subprocess.Popen(
        [sys.executable, "-c", script], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    with main:
        started = [int(pid) for pid in main.stdout.readline().split()]
        assert len(started) == 2
        main.kill()
    deadline = time.monotonic() + 20
    while any(running(pid) for pid in started):
        assert time.monotonic() < deadline, "a process is still there"
        time.sleep(0.05)


def running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").split()[2] != "Z"
    except OSError:
        return False


def test_the_package_does_not_import_torch():
    """The processes are to start quickly."""
    code = "import sys, trl_explore.envs.processes; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
