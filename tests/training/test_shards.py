"""Shards of trials: whatever the partition and the threads, a job gives the same."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from trl_explore.collectors import FusedCollector
from trl_explore.strategies import Softmax
from trl_explore.training import shards as module
from trl_explore.training.shards import Shards, partition
from trl_explore.training.trials import Trials


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
@pytest.mark.parametrize("trials", [1, 30, 127, 128, 300, 4096, 4097, 15_000])
def test_a_partition_has_all_trials_and_fits_the_cache(trials, threads):
    sizes = partition(trials, threads)
    assert sum(sizes) == trials
    assert max(sizes) - min(sizes) <= 1
    assert max(sizes) <= module.LARGEST
    assert len(sizes) == 1 or min(sizes) >= module.SMALLEST
    if trials >= threads * module.SMALLEST:
        assert len(sizes) % threads == 0  # no thread is idle while others work


def test_one_thread_cuts_large_jobs_only():
    assert partition(4096) == [4096]
    assert len(partition(15_000)) == 4


def records(*sizes: int, **options) -> list[Trials]:
    return [Trials(size, **options) for size in sizes]


def fill(trials: Trials, scores: np.ndarray, rng: np.random.Generator) -> None:
    """Enter columns of scores [iterations, n] until every trial has stopped; some diverge."""
    for i, row in enumerate(scores):
        if trials.active.any():
            own = row[trials.active]
            trials.record(own, own.astype(np.int64), own < 0, float(i))


@pytest.mark.parametrize("sizes", [(7,), (3, 4), (1, 1, 5), (2, 2, 2, 1)])
def test_joined_records_are_the_record_of_all(sizes):
    """To the last bit, also the averages of trials that stop in different shards and iterations."""
    rng = np.random.default_rng(0)
    scores = rng.normal(20, 10, (40, 7))
    options = {"max_iterations": 40, "score_threshold": 24.0, "score_window": 4}
    (whole,), parts = records(7, **options), records(*sizes, **options)
    fill(whole, scores, rng)
    low = 0
    for part in parts:
        fill(part, scores[:, low : low + len(part)], rng)
        low += len(part)
    assert len(set(whole.iterations)) > 2
    assert set(whole.status) >= {"converged", "diverged"}
    joined = Trials.joined(parts)
    for name in ("status", "iterations", "frames", "seconds", "score", "converged"):
        assert getattr(joined, name).tolist() == getattr(whole, name).tolist(), name
    for columns in ("episodes", "curves"):
        expected = getattr(whole, columns)()
        for name, column in getattr(joined, columns)().items():
            assert column.dtype == expected[name].dtype
            assert column.tobytes() == expected[name].tobytes(), name


def test_curves_by_hand():
    """The averages are those of a plain loop over all trials."""
    trials = Trials(5, max_iterations=30, score_threshold=24.0, score_window=3)
    scores = np.random.default_rng(1).normal(20, 8, (30, 5))
    fill(trials, scores, np.random.default_rng(0))
    curves = trials.curves()
    for i in range(trials.iteration):
        shown, final = [], []
        for k, n in enumerate(trials.iterations.tolist()):
            mean = np.mean(scores[max(0, min(i + 1, n) - 3) : min(i + 1, n), k])
            final.append(mean)
            shown.append(scores[i, k] if i < n else mean)
        assert curves["episode_score"][i] == pytest.approx(np.mean(shown))
        assert curves["score"][i] == pytest.approx(np.mean(final))
        assert curves["active"][i] == sum(trials.iterations > i + 1)
        assert curves["converged"][i] == sum(trials.converged & (trials.iterations <= i + 1))


def built(build, sizes: list[int], **options) -> Shards:
    edges = np.cumsum([0, *sizes]).tolist()
    return Shards([
        build(Softmax(), size, first_trial=first, collector=FusedCollector, **options)
        for size, first in zip(sizes, edges, strict=False)
    ])  # fmt: skip


def test_threads_take_shards_from_a_queue(build):
    shards, seen = built(build, [2, 2, 2, 2, 2], max_iterations=3), {}
    for k, trainer in enumerate(shards.trainers):
        trainer.on_iteration = lambda trials, k=k: seen.setdefault(k, []).append(
            threading.current_thread().name
        )
    trials = shards.run(threads=2)
    assert len(trials) == 10
    assert all(len(set(names)) == 1 for names in seen.values())
    assert len(seen) == 5
    assert threading.main_thread().name not in {name for names in seen.values() for name in names}
    assert all(trainer.collector.closed for trainer in shards.trainers)


@pytest.mark.parametrize(("sizes", "threads"), [([4], 3), ([2, 2], 1)])
def test_one_thread_or_one_shard_needs_no_other_thread(build, sizes, threads):
    shards, seen = built(build, sizes, max_iterations=2), set()
    for trainer in shards.trainers:
        trainer.on_iteration = lambda trials: seen.add(threading.current_thread())
    shards.run(threads)
    assert seen == {threading.main_thread()}


def test_an_error_in_one_shard_stops_the_others(build):
    shards = built(build, [1, 1, 1, 1], max_iterations=10**6, score_threshold=1e9)

    def fail(trials) -> None:
        if trials.iteration == 20:
            raise ValueError("the loss is broken")

    shards.trainers[1].on_iteration = fail
    started = time.monotonic()
    with pytest.raises(ValueError, match="the loss is broken"):
        shards.run(threads=2)
    assert time.monotonic() - started < 60
    assert shards.trainers[0].trials.active.all()  # it did not come to its end
    assert shards.trainers[3].trials.iteration == 0


def test_seconds_are_wall_time_and_go_on(build):
    shards = built(build, [2, 2], max_iterations=3)
    shards.resume(100.0)
    started = time.perf_counter()
    shards.run(threads=2)
    assert 100 < shards.seconds <= 100 + time.perf_counter() - started
