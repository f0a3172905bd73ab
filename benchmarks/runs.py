"""The timed runs of each kind, and the agents that they train.

Only training is timed. Agents are built and code is compiled before the clock starts.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, cast

import numpy as np
from plain import train as train_plain
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.envs import Compose, GymEnv, RewardSum, StepCounter, TransformedEnv
from torchrl.envs.utils import ExplorationType

from trl_explore.collectors import FusedCollector, TorchRLCollector
from trl_explore.envs import make_env
from trl_explore.numerics.streams import Stream
from trl_explore.objectives import ReinforceLoss
from trl_explore.policies import LinearPolicy
from trl_explore.policies.actor import SoftmaxActor
from trl_explore.strategies import (
    Argmax,
    DecayingEpsilonGreedy,
    EpsilonGreedy,
    Random,
    Softmax,
    Strategy,
)
from trl_explore.training.evaluation import Evaluator
from trl_explore.training.optimizers import LaneAdam
from trl_explore.training.shards import Shards, partition
from trl_explore.training.trainer import Trainer
from trl_explore.training.trials import Trials

STRATEGIES: dict[str, Callable[[], Strategy]] = {
    "random": Random,
    "argmax": Argmax,
    "epsilon_greedy": lambda: EpsilonGreedy(0.3),
    "decaying_epsilon_greedy": lambda: DecayingEpsilonGreedy(0.99),
    "softmax": Softmax,
}
CAP = 1000
"""Iterations after which a trial of the thesis stops."""
STOCK_BATCH = 500
"""Frames per batch of the stock collector."""


@dataclass(frozen=True)
class Run:
    """One timed run.

    Attributes:
        seconds: wall time of the training.
        frames: environment steps.
        iterations: iterations of the whole batch of trials.
        steps: steps of the batch of lanes; each advances all unfinished lanes.
    """

    seconds: float
    frames: int
    iterations: int = 0
    steps: int = 0

    @property
    def speed(self) -> float:
        """Frames per second."""
        return self.frames / self.seconds


def build(
    strategy: str,
    trials: int,
    *,
    first_trial: int = 0,
    lanes: bool = False,
    max_iterations: int = CAP,
    evaluates: bool = False,
) -> Trainer:
    """The thesis's agents, as ``scripts/train.py`` builds them by default.

    Args:
        strategy: a name of ``STRATEGIES``.
        trials: the number of trials.
        first_trial: the index of the first one.
        lanes: whether the ``TorchRLCollector`` collects, instead of the fused one.
        max_iterations: the cap.
        evaluates: whether to evaluate what the agents learned, as by default.
    """
    env = make_env("CartPole-v1", trials, 500, first_trial=first_trial)
    policy = LinearPolicy(env, first_trial=first_trial)
    modules: list[Any] = [policy, STRATEGIES[strategy]()]
    both = TensorDictSequential(*modules)
    collector = TorchRLCollector(env, both) if lanes else FusedCollector(env, both)
    loss = ReinforceLoss(SoftmaxActor(policy), trials=trials, functional=False)
    record = Trials(trials, max_iterations=max_iterations)
    evaluator = None
    if evaluates:
        greedy: list[Any] = [policy, Argmax()]
        evaluator = Evaluator(
            FusedCollector(
                make_env(
                    "CartPole-v1", trials, 500, first_trial=first_trial, stream=Stream.EVALUATION
                ),
                TensorDictSequential(*greedy),
                exploration_type=cast(Any, ExplorationType.DETERMINISTIC),
            ),
            threshold=record.score_threshold,
            max_iterations=max_iterations,
            most=100,
        )
    return Trainer(collector, loss, LaneAdam(policy.parameters()), record, evaluator=evaluator)


def train(shards: Shards, threads: int = 1) -> Run:
    """Train until every trial has stopped."""
    gc.collect()
    started = time.perf_counter()
    trials = shards.run(threads)
    seconds = time.perf_counter() - started
    episodes = trials.episodes()
    longest = np.zeros(trials.iteration + 1, dtype=np.int64)
    np.maximum.at(longest, episodes["iteration"].astype(np.int64), episodes["frames"])
    return Run(seconds, int(trials.frames.sum()), trials.iteration, int(longest.sum()))


def together(runs: Iterable[Run]) -> Run:
    """Several successive runs, added up as one run."""
    seconds, frames, iterations, steps = (
        sum(column)
        for column in zip(
            *((r.seconds, r.frames, r.iterations, r.steps) for r in runs), strict=True
        )
    )
    return Run(seconds, int(frames), int(iterations), int(steps))


def fused(
    strategy: str, trials: int, threads: int = 1, first_trial: int = 0, max_iterations: int = CAP
) -> Run:
    """Train all trials with the fused collector, in shards, each by one thread."""
    sizes = partition(trials, threads)
    trainers = [
        build(strategy, size, first_trial=first, max_iterations=max_iterations)
        for size, first in zip(sizes, accumulate(sizes, initial=first_trial), strict=False)
    ]
    return train(Shards(trainers), threads)


def fused_alone(trials: int, max_iterations: int = CAP) -> Run:
    """Train the first softmax trials alone, one after the other, with the fused collector."""
    runs = [fused("softmax", 1, 1, k, max_iterations) for k in range(trials)]
    return together(runs)


def lanes(trials: int, max_iterations: int = CAP) -> Run:
    """Train all softmax trials at once with the ``TorchRLCollector``."""
    trainer = build("softmax", trials, lanes=True, max_iterations=max_iterations)
    return train(Shards([trainer]))


def plain(strategy: str, seeds: Iterable[int], max_iterations: int = CAP) -> Run:
    """Train with the plain loop, one trial after the other."""
    gc.collect()
    runs = []
    for seed in seeds:
        started = time.perf_counter()
        result = train_plain(strategy, seed, max_iterations)
        seconds = time.perf_counter() - started
        runs.append(Run(seconds, result.frames, result.iterations, result.frames))
    return together(runs)


def trained_weight() -> Tensor:
    """W [n_actions, n_features] of a trained softmax trial, which gives episodes of full length."""
    trainer = build("softmax", 1)
    trainer.run()
    return next(trainer.collector.policy.parameters()).detach()[0].clone()


def stock(weight: Tensor, frames: int) -> Run:
    """Collect with TorchRL's own ``Collector`` over one ``GymEnv``, without training.

    Args:
        weight: the weight of a trained policy, so that resets are few.
        frames: the number of frames to collect, after a first batch that is not timed.
    """
    linear = nn.Linear(weight.shape[1], weight.shape[0], bias=False)
    linear.weight.data.copy_(weight)
    logits = TensorDictModule(linear, in_keys=["observation"], out_keys=["logits"])
    modules: list[Any] = [logits, Softmax()]
    transforms: list[Any] = [StepCounter(), RewardSum()]
    env = GymEnv("CartPole-v1", categorical_action_encoding=True)
    collector = Collector(
        TransformedEnv(env, Compose(*transforms)),
        policy=TensorDictSequential(*modules),
        frames_per_batch=STOCK_BATCH,
        total_frames=STOCK_BATCH + frames,
        auto_register_policy_transforms=False,
    )
    collector.set_seed(0)
    batches = iter(collector)
    next(batches)
    gc.collect()
    started = time.perf_counter()
    collected = sum(batch.numel() for batch in batches)
    seconds = time.perf_counter() - started
    collector.shutdown()
    return Run(seconds, collected, steps=collected)
