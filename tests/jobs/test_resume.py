"""A training that was broken off at any boundary goes on as if nothing had happened."""

from __future__ import annotations

import errno
import logging
import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf

from trl_explore.collectors import FusedCollector, TorchRLCollector
from trl_explore.config import CONF
from trl_explore.config.checking import options
from trl_explore.jobs import resume
from trl_explore.jobs.checkpoint import HISTORY, Store, pack
from trl_explore.jobs.resume import Checkpoints, Saver, restore
from trl_explore.jobs.signals import Interrupted, Interrupts
from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.corrections import AsIf
from trl_explore.strategies import DecayingEpsilonGreedy, EpsilonGreedy, Softmax
from trl_explore.training.optimizers import LaneAdam, torch_optimizer

STRATEGIES = [CONF / "strategy" / f"{name}.yaml" for name in options("strategy", "discrete")]
SMALL = {"max_iterations": 8, "score_window": 3, "score_threshold": 45.0, "max_steps": 60}


class StopError(Exception):
    """Stands for a kill."""


def outcome(trainer) -> list:
    """Everything that a run ends with, but for wall time, as bytes."""
    trials = trainer.trials
    arrays = [
        *(parameter.detach().numpy() for parameter in trainer.optimizer.parameters),
        trials.status, trials.iterations, trials.score, trials.frames,
        *trials.episodes().values(), *trials.curves().values(),
    ]  # fmt: skip
    return [(array.dtype.str, array.shape, array.tobytes()) for array in arrays]


def saver_of(store: Store, trainer, *, seconds: float = 0.0) -> Saver:
    trainer.on_iteration = Saver(store, trainer, {}, Interrupts(lambda: None), seconds=seconds)
    return trainer.on_iteration


def run_with_stops(make, folder: Path, stops: list[int]):
    """Train, killed after each of the iterations ``stops``, every time in a new trainer."""
    for stop in [*stops, None]:
        trainer, store = make(), Store(folder)
        found, damaged = store.load()
        assert damaged == []
        if found is not None:
            restore(trainer, found)
        save = saver_of(store, trainer)

        def on_iteration(trials, save=save, stop=stop) -> None:
            save(trials)
            if trials.iteration == stop:
                raise StopError

        trainer.on_iteration = on_iteration
        try:
            trainer.run()
        except StopError:
            continue
        assert stop is None
        return trainer
    raise AssertionError


@pytest.mark.parametrize("file", STRATEGIES, ids=lambda file: file.stem)
def test_every_strategy_goes_on(file, build, tmp_path):
    def make():
        return build(instantiate(OmegaConf.load(file)), 3, **SMALL)

    straight = make()
    straight.run()
    assert straight.trials.iteration > 4
    stopped = run_with_stops(make, tmp_path, [1, 2, 4])
    assert outcome(stopped) == outcome(straight)


@pytest.mark.parametrize("optimizer", [LaneAdam, partial(torch_optimizer, name="Adam")])
@pytest.mark.parametrize("collector", [TorchRLCollector, FusedCollector])
@pytest.mark.parametrize("k", [1, 3])
def test_every_optimiser_and_collector_goes_on(optimizer, collector, k, build, tmp_path):
    def make():
        return build(
            EpsilonGreedy(0.2), 4, seed=5, first_trial=2,
            optimizer=partial(optimizer, lr=0.05),
            collector=partial(collector, episodes_per_update=k), **SMALL,
        )  # fmt: skip

    straight = make()
    straight.run()
    stopped = run_with_stops(make, tmp_path, [1, 2, 3])
    assert outcome(stopped) == outcome(straight)


def test_the_bias_of_a_decaying_strategy_goes_on(build, tmp_path):
    def make():
        strategy, other = Softmax(), DecayingEpsilonGreedy(0.7)
        loss = partial(ReinforceLoss, correction=AsIf(other), strategy=strategy)
        return build(strategy, 3, loss=loss, **SMALL)

    straight = make()
    straight.run()
    stopped = run_with_stops(make, tmp_path, [1, 2, 4])
    assert outcome(stopped) == outcome(straight)


def test_seconds_go_on(build, tmp_path):
    def make():
        return build(Softmax(), 2, **{**SMALL, "score_threshold": 1e9})

    trainer = make()
    saver_of(Store(tmp_path), trainer)
    trainer.run()
    found, _ = Store(tmp_path).load()
    assert found is not None
    again = make()
    restore(again, found)
    assert again.seconds == trainer.seconds > 0
    assert again.trials.seconds.tolist() == trainer.trials.seconds.tolist()
    again.run()  # nothing is left to do
    assert outcome(again) == outcome(trainer)


def test_a_checkpoint_after_every_iteration_or_after_some_time(build, tmp_path, monkeypatch):
    saved = []

    def save(store, header, state, history) -> None:
        saved.append(header["iteration"])

    monkeypatch.setattr(Store, "save", save)
    for seconds, expected in ((0, list(range(1, 9))), (1000, [])):
        trainer = build(Softmax(), 1, **{**SMALL, "score_threshold": 1e9})
        saver_of(Store(tmp_path), trainer, seconds=seconds)
        trainer.run()
        assert saved == expected
        saved.clear()


def test_checkpoints_take_a_small_share_of_the_time(build, tmp_path, monkeypatch):
    """On a disk that needs 0.5 s for each, they come every 50 s, not every second."""
    now, saved = [0.0], []

    def save(store, header, state, history) -> None:
        saved.append(now[0])
        now[0] += 0.5

    monkeypatch.setattr(Store, "save", save)
    monkeypatch.setattr(resume.time, "monotonic", lambda: now[0])
    trainer = build(Softmax(), 1, **SMALL)
    saver = saver_of(Store(tmp_path), trainer, seconds=1)
    for _ in range(1500):
        now[0] += 0.1
        saver(trainer.trials)
    assert saved == pytest.approx([1.0, 51.5, 102.0], abs=0.3)


def test_a_full_disk_ends_no_training(build, tmp_path, monkeypatch, caplog):
    def make():
        return build(Softmax(), 3, **SMALL)

    straight = make()
    straight.run()
    trainer = make()
    saver_of(Store(tmp_path), trainer)

    def full(number):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch, caplog.at_level(logging.WARNING):
        patch.setattr(os, "fsync", full)
        trainer.run()
    assert outcome(trainer) == outcome(straight)
    (record,) = caplog.records
    assert record.getMessage().startswith("cannot write a checkpoint (No space left on device)")


def broken_off(trainer, frames: int) -> None:
    """Let a signal break off the collection after so many steps of the environment."""
    env, step, left = trainer.collector.env.base_env, trainer.collector.env.base_env._step, [frames]

    def wrapped(*args, **kwargs):
        left[0] -= 1
        if left[0] == 0:
            raise Interrupted(2)
        return step(*args, **kwargs)

    env._step = wrapped


@pytest.mark.parametrize("file", STRATEGIES, ids=lambda file: file.stem)
def test_what_was_broken_off_within_an_iteration_is_thrown_away(file, build, tmp_path, monkeypatch):
    """The state before the iteration is kept if iterations are slow; here, all of them are."""
    monkeypatch.setattr(resume, "SLOW", -1.0)

    def make():
        return build(instantiate(OmegaConf.load(file)), 2, **SMALL)

    straight = make()
    straight.run()
    trainer, store = make(), Store(tmp_path)
    saver = saver_of(store, trainer, seconds=1000)
    broken_off(trainer, 70)
    with pytest.raises(Interrupted):
        trainer.run()
    assert saver.saved == 0
    saver.rescue()
    assert 0 < saver.saved <= trainer.trials.iteration
    saver._due = 0.0
    monkeypatch.setattr(store, "save", None)
    saver(trainer.trials)  # of a thread that still runs the iteration
    again = make()
    found, _ = Store(tmp_path).load()
    assert found is not None
    restore(again, found)
    assert again.trials.iteration == saver.saved
    again.run()
    assert outcome(again) == outcome(straight)


def test_a_history_that_has_gone_is_written_again_from_the_beginning(build, tmp_path):
    def make():
        return build(Softmax(), 2, **{**SMALL, "score_threshold": 1e9})

    straight = make()
    straight.run()
    trainer, store = make(), Store(tmp_path)
    saver = saver_of(store, trainer)

    def on_iteration(trials) -> None:
        if trials.iteration == 4:
            (store.folder / HISTORY).unlink()
        saver(trials)
        if trials.iteration == 5:
            raise StopError

    trainer.on_iteration = on_iteration
    with pytest.raises(StopError):
        trainer.run()
    again = make()
    found, damaged = Store(tmp_path).load()
    assert found is not None
    assert damaged == []
    restore(again, found)
    assert again.trials.iteration == 5
    again.run()
    assert outcome(again) == outcome(straight)


def test_a_signal_ends_at_the_boundary_with_a_checkpoint(build, tmp_path):
    trainer = build(Softmax(), 2, **{**SMALL, "score_threshold": 1e9})
    store = Store(tmp_path)
    saver = saver_of(store, trainer, seconds=1000)

    def on_iteration(trials) -> None:
        if trials.iteration == 3:
            saver.interrupts.pending = Interrupted(15)
        saver(trials)

    trainer.on_iteration = on_iteration
    with pytest.raises(Interrupted) as caught:
        trainer.run()
    assert caught.value.status == 143
    found, _ = Store(tmp_path).load()
    assert found is not None
    assert found.header["iteration"] == saver.saved == 3


def test_a_state_that_cannot_be_written_is_refused_at_the_beginning(build, tmp_path):
    trainer = build(Softmax(), 1)
    trainer.parts["memory"] = type("Memory", (), {"state_dict": lambda self: {"seen": {1, 2}}})()
    with pytest.raises(TypeError, match=r"parts\.memory\.seen.*set"):
        saver_of(Store(tmp_path), trainer)


def test_a_checkpoint_of_another_program_is_refused(build, tmp_path):
    trainer = build(Softmax(), 2, **SMALL)
    state = trainer.state_dict()
    del state["parts"]["optimizer"]["steps"]
    store = Store(tmp_path)
    store.save({"iteration": 0}, pack(state), {})
    found, _ = store.load()
    assert found is not None
    with pytest.raises(ValueError, match="checkpoint"):
        restore(build(Softmax(), 2, **SMALL), found)


def test_the_record_in_parts_is_the_record(build):
    trainer = build(Softmax(), 5, **SMALL)
    trainer.run()
    copy = build(Softmax(), 5, **SMALL)
    for low, high in ((0, 2), (2, 3), (3, 3), (3, None)):
        copy.load_history(trainer.history(low, high))
    copy.load_state_dict(trainer.state_dict())
    assert outcome(copy) == outcome(trainer)
    with pytest.raises(ValueError, match="iteration"):
        build(Softmax(), 5, **SMALL).load_state_dict(trainer.state_dict())


def test_scores_that_no_small_type_holds_come_back_exactly():
    from trl_explore.training.trials import Trials

    scores = [np.array([0.1, 1e300]), np.array([-0.0, np.nan])]
    one, two = (Trials(2, max_iterations=9, score_threshold=1e308) for _ in range(2))
    for score in scores:
        one.record(score, np.array([1, 2**40]), np.zeros(2, np.bool_), 0.0)
    two.load_history(one.history())
    for name, column in one.episodes().items():
        assert column.tobytes() == two.episodes()[name].tobytes()


def test_torch_weights_stay_float32(build, tmp_path):
    trainer = build(Softmax(), 1, **SMALL)
    store = Store(tmp_path)
    saver_of(store, trainer)
    trainer.run()
    found, _ = store.load()
    assert found is not None
    again = build(Softmax(), 1, **SMALL)
    restore(again, found)
    assert all(p.dtype is torch.float32 for p in again.optimizer.parameters)


def test_a_folder_of_another_name_is_no_shard(tmp_path):
    (tmp_path / "checkpoint" / "²").mkdir(parents=True)
    checkpoints = Checkpoints(tmp_path)
    assert checkpoints.header is None
    checkpoints.clear()
    assert not (tmp_path / "checkpoint").exists()
