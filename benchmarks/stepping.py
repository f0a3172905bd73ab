"""Measure the stepping collector against ``env.step`` alone, and write ``stepping.md``.

Raw is the same episodes again: ``env.step`` of one environment of gymnasium with the actions that
the collector has drawn, as Python ints or arrays, without resets. Times are of the processor, so
that other programs do not count; with two processes they are wall times.
"""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from machine import description, load
from tensordict.nn import TensorDictSequential

from trl_explore.collectors import EpisodeCollector, SteppingCollector, TorchRLCollector
from trl_explore.envs import make_env
from trl_explore.numerics.streams import Stream, generator
from trl_explore.policies import GaussianLinearPolicy, LinearPolicy
from trl_explore.strategies import Gaussian, Softmax

HERE = Path(__file__).resolve().parent
GOALS = {
    ("CartPole-v1", 1): None,
    ("CartPole-v1", 30): 0.70,
    ("Pendulum-v1", 1): None,
    ("Pendulum-v1", 30): 0.70,
    ("LunarLander-v3", 1): 0.60,
    ("LunarLander-v3", 30): 0.85,
    ("BipedalWalker-v3", 1): None,
    ("BipedalWalker-v3", 30): 0.85,
}
"""The environments and numbers of trials, and the least share of the raw speed."""
FRAMES = 6_000
"""The fewest frames of a round."""
PROCESSES = ("LunarLander-v3", "BipedalWalker-v3")


class Speed(NamedTuple):
    """Frames per second of one round."""

    raw: float
    stepping: float


def build(kind: type[EpisodeCollector], id: str, trials: int, workers: int = 1) -> EpisodeCollector:
    """A collector with a linear policy and its own distribution."""
    env = make_env(id, trials, workers=workers)
    continuous = env.action_spec.domain == "continuous"
    policy = GaussianLinearPolicy(env) if continuous else LinearPolicy(env)
    modules: list[Any] = [policy, Gaussian() if continuous else Softmax()]
    return kind(env, TensorDictSequential(*modules))


def collect(collector: EpisodeCollector) -> tuple[int, float, list[tuple[int, int, list[Any]]]]:
    """Frames, seconds without resets, and (trial, episode, actions) of every episode."""
    lanes, spent, begin = collector.lanes, [0.0], collector.lanes.begin
    space: Any = lanes.single_action_space

    def timed(lanes: Any) -> None:
        started = time.process_time()
        begin(lanes)
        spent[0] += time.process_time() - started

    lanes.begin = timed
    episodes, frames, seconds = [], 0, 0.0
    while frames < FRAMES:
        numbers = collector.episodes.copy()
        started = time.process_time()
        data = collector.collect().frames
        seconds += time.process_time() - started
        frames += len(data)
        trial, action = data.get("trial").numpy(), data.get("action").numpy()
        for k in range(collector.trials):
            own = action[trial == k]
            sent = own.tolist() if own.ndim == 1 else list(np.clip(own, space.low, space.high))
            episodes.append((k, int(numbers[k]), sent))
    lanes.begin = begin
    return frames, seconds - spent[0], episodes


def replay(id: str, episodes: list[tuple[int, int, list[Any]]]) -> float:
    """Seconds of ``env.step`` for these episodes."""
    env, seconds = gym.make(id, disable_env_checker=True), 0.0
    for trial, episode, actions in episodes:
        env.unwrapped.np_random = generator(0, Stream.ENVIRONMENT, trial, episode)
        env.reset()
        started = time.process_time()
        for action in actions:
            env.step(action)
        seconds += time.process_time() - started
    return seconds


def measure(id: str, trials: int, repeats: int) -> tuple[list[Speed], float]:
    """The rounds of raw and stepping, one after the other, and the speed of TorchRL's stepping."""
    stepping, torchrl = (build(kind, id, trials) for kind in (SteppingCollector, TorchRLCollector))
    stepping.collect()
    rounds = []
    for _ in range(repeats):
        frames, seconds, episodes = collect(stepping)
        rounds.append(Speed(frames / replay(id, episodes), frames / seconds))
    started, frames = time.process_time(), 0
    while frames < FRAMES // 10:
        frames += len(torchrl.collect().frames)
    return rounds, frames / (time.process_time() - started)


def gain(id: str, repeats: int) -> float:
    """The wall time of 30 trials in one process, as a multiple of that in two."""
    pair = [build(SteppingCollector, id, 30, workers) for workers in (1, 2)]
    gains = []
    for _ in range(repeats + 1):
        seconds = []
        for collector in pair:
            started = time.perf_counter()
            collector.collect()
            seconds.append(time.perf_counter() - started)
        gains.append(seconds[0] / seconds[1])
    for collector in pair:
        collector.shutdown()
    return statistics.median(gains[1:])


def document(repeats: int) -> str:
    """The tables as Markdown."""
    facts = "\n".join(f"| {name} | {value} |" for name, value in description())
    lines = [
        "# Stepping: any gymnasium environment\n",
        f"| | this machine |\n|---|---|\n{facts}\n| load average before | {load()} |\n",
        "Linear policy with its own softmax or Gaussian, initial weights. Frames per second, "
        f"medians of {repeats} rounds, in processor time. *raw*: the same actions again with "
        "`env.step` of one environment, without resets; *stepping*: collection without resets, "
        "measured before raw in every round; *torchrl*: collection, one round.\n",
        "| environment | trials | raw | torchrl | stepping | × torchrl | of raw | goal |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for (id, trials), goal in GOALS.items():
        rounds, torchrl = measure(id, trials, repeats)
        raw, stepping = (statistics.median(column) for column in zip(*rounds, strict=True))
        share = statistics.median(r.stepping / r.raw for r in rounds)
        wanted = f"{goal:.0%}" if goal else ""
        lines.append(
            f"| {id} | {trials} | {raw:,.0f} | {torchrl:,.0f} | {stepping:,.0f} "
            f"| {stepping / torchrl:.1f} | {share:.0%} | {wanted} |"
        )
        print(lines[-1], file=sys.stderr, flush=True)
    lines.append("\nWith `env.workers=2`, 30 trials, wall time with resets:\n")
    lines += [f"- {id}: {gain(id, repeats):.2f} times as fast" for id in PROCESSES]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    torch.set_num_threads(1)
    text = document(repeats=int(sys.argv[1]) if len(sys.argv) > 1 else 5)
    (HERE / "stepping.md").write_text(text, encoding="utf-8")
    print(text, end="")
