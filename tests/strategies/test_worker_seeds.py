"""Random numbers and schedules in worker processes."""

import multiprocessing
import os
import pickle
import warnings
from multiprocessing import context
from weakref import WeakSet

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torchrl.collectors import MultiSyncCollector
from torchrl.data import OneHot

from tests.strategies.samples import cartpole, network
from trl_explore.strategies import (
    EpsilonGreedy,
    Random,
    worker_seeds,
)
from trl_explore.strategies.schedules import Linear


def test_workers_draw_their_own_numbers_and_follow_the_schedule():
    torch.manual_seed(0)
    target = network()
    torch.nn.init.zeros_(target.module.weight)
    target.module.bias.data = torch.tensor([1.0, 0.0])  # action 0 is greedy
    strategy = EpsilonGreedy(Linear(1.0, 0.0, frames=200), spec=OneHot(2))
    policy = TensorDictSequential(target, strategy)
    batches = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        collector = MultiSyncCollector(
            [cartpole] * 2, policy, frames_per_batch=200, total_frames=400,
            auto_register_policy_transforms=False,
        )  # fmt: skip
        for batch in collector:
            batches.append(batch["action"].int().argmax(-1).reshape(2, 100))
            strategy.step(batch.numel())
            collector.update_policy_weights_(policy)
        collector.shutdown()
    first, last = batches
    assert 0.3 < (first[0] == first[1]).float().mean() < 0.7  # ε = 1: half of the actions
    assert last.sum() == 0  # ε = 0


def spawned(strategy):
    """The bytes of a strategy that is an argument of a process being spawned."""
    context.set_spawning_popen(object())
    try:
        return pickle.dumps(strategy)
    finally:
        context.set_spawning_popen(None)


def arrive(sent):
    return pickle.loads(sent)(TensorDict({"logits": torch.zeros(50, 4)}, [50]))["action"]


def test_spawned_processes_get_different_seeds_that_the_parents_seed_decides():
    with torch.random.fork_rng():
        runs = []
        for seed in (1, 1, 2):
            torch.manual_seed(seed)
            sent = [spawned(Random()) for _ in range(2)]
            runs.append([arrive(part) for part in sent])
        one, again, other = runs
        assert all(torch.equal(a, b) for a, b in zip(one, again, strict=True))
        assert not torch.equal(one[0], one[1])
        assert not torch.equal(one[0], other[0])
        torch.manual_seed(3)  # a copy within the process seeds nothing
        pickle.loads(pickle.dumps(Random()))
        assert torch.initial_seed() == 3


def send_actions(strategy, pipe):
    pipe.send(strategy(TensorDict({"logits": torch.zeros(50, 4)}, [50]))["action"].tolist())


@pytest.mark.filterwarnings("ignore:.*fork.*")
def test_without_a_strategy_a_fork_leaves_torchs_generator_alone(monkeypatch):
    monkeypatch.setattr(worker_seeds, "_strategies", WeakSet())
    before = torch.get_rng_state()
    child = os.fork()
    if child == 0:
        os._exit(int(not torch.equal(torch.get_rng_state(), before)))
    assert os.waitpid(child, 0)[1] == 0
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.filterwarnings("ignore:.*fork.*")
def test_forked_processes_get_different_seeds_that_the_parents_seed_decides():
    fork, found = multiprocessing.get_context("fork"), []
    with torch.random.fork_rng():
        for _ in range(2):
            torch.manual_seed(1)
            for _ in range(2):
                here, there = fork.Pipe()
                process = fork.Process(target=send_actions, args=(Random(), there))
                process.start()
                found.append(here.recv())
                process.join()
    assert found[:2] == found[2:]
    assert found[0] != found[1]
