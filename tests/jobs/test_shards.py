"""The files of a job are the same for every partition, any threads, and after any interruption."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from trl_explore import config as configuration
from trl_explore import jobs as results
from trl_explore.config import CONF, ConfigError, build_shards
from trl_explore.jobs import resume
from trl_explore.jobs.resume import Checkpoints
from trl_explore.jobs.signals import Interrupted, Interrupts
from trl_explore.training import shards as module
from trl_explore.training.shards import Shards

TRIALS = 9
SMALL = [f"trials={TRIALS}", "max_iterations=12", "score_window=3", "score_threshold=30",
         "env.max_steps=60", "first_trial=5", "seed=3"]  # fmt: skip
EPSILONS = [round(0.1 * k, 1) for k in range(TRIALS)]
JOBS = {
    "per trial": [
        "strategy=epsilon_greedy", f"strategy.epsilon={EPSILONS}", "diagnostics=true",
        "evaluate_every=3", "evaluate_episodes=2", "baseline=linear_value", "episodes_per_update=2",
        "keep_weights=[7,0,12]",
    ],
    "stopped by evaluation": [
        "evaluate_every=2", "stop_on=learned", "optimizer=torch", "keep_weights=[2,11]",
    ],
    "learns from data": ["strategy=vdbe", "baseline=step_mean", "evaluate_every=4"],
    "counts": ["strategy=count_bonus", "diagnostics=true", "intrinsic_reward=0.1"],
    "noise": ["strategy=parameter_noise", "baseline=episode_mean", "diagnostics=true"],
    "schedule": [
        "strategy=softmax", "policy=mlp",
        "strategy.temperature={_target_: trl_explore.strategies.schedules.Constant, "
        f"value: {[1 + e for e in EPSILONS]}}}",
    ],
}  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def hydra():
    configuration.register_resolvers()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        yield


def composed(name: str, *overrides: str):
    return compose("train", [*SMALL, *JOBS[name], *overrides], return_hydra_config=True)


def files(config, shards: Shards, folder: Path) -> dict[str, bytes]:
    """Every file of a job that has been trained, but for its wall time."""
    folder.mkdir(parents=True, exist_ok=True)
    values = OmegaConf.to_container(config)
    values = {key: value for key, value in values.items() if key != "hydra"}
    results.write_job(
        folder, shards.trials(), shards.weights(), config=values, experiment="train", strategy="x",
        collector="x", seconds=1.0, **shards.recorded(),
    )  # fmt: skip
    found = {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*.*") if p.is_file()}
    del found["run.json"]  # it has the hashes of the others
    rows = [line.split(",") for line in found.pop("trials.csv").decode().splitlines()]
    found["trials.csv"] = repr([row[:6] + row[7:] for row in rows]).encode()
    return {name: data for name, data in found.items() if "checkpoint" not in name}


def straight(name: str, folder: Path) -> dict[str, bytes]:
    """The files of a job in one shard."""
    config = composed(name)
    shards = build_shards(config)
    assert len(shards.trainers) == 1
    shards.run()
    found = files(config, shards, folder)
    assert len(set(shards.trials().iterations)) > 1 or name in ("counts", "noise")
    return found


@pytest.mark.parametrize("name", JOBS)
def test_partition_and_threads_change_no_byte(name, tmp_path):
    expected = straight(name, tmp_path / "one")
    for sizes, threads in (([1] * TRIALS, 3), ([2, 6, 1], 1), ([4, 5], 2)):
        config = composed(name)
        shards = build_shards(config, sizes)
        shards.run(threads if shards.trainers[0].parallel else 1)
        found = files(config, shards, tmp_path / str(threads))
        assert found.keys() == expected.keys()
        assert [file for file in found if found[file] != expected[file]] == []


def test_only_what_gains_by_threads_is_divided(monkeypatch):
    monkeypatch.setattr(module, "SMALLEST", 2)
    counts = [len(build_shards(composed(name, "threads=2")).trainers) for name in JOBS]
    assert counts == [2, 2, 2, 1, 2, 2]


def test_a_shard_that_has_stopped_is_not_trained_again(tmp_path):
    def attached() -> Shards:
        shards, checkpoints = build_shards(composed("noise"), [4, 5]), Checkpoints(tmp_path)
        checkpoints.attach(shards, {}, Interrupts(lambda: None), seconds=1e9)
        for trainer, saver in zip(shards.trainers, checkpoints.savers, strict=True):
            trainer.on_iteration = saver
        return shards

    attached().run()
    assert not any(trainer.trials.active.any() for trainer in attached().trainers)


@pytest.mark.parametrize("values", [[0.1] * 4, [0.1] * (TRIALS + 1)])
def test_parameters_for_other_trials_are_refused(values):
    config = composed("per trial", f"strategy.epsilon={values}")
    for sizes in (None, [4, 5]):
        with pytest.raises(ConfigError, match=rf"{len(values)} values, but there are 9 trials"):
            build_shards(config, sizes)


def begin(config, folder: Path, interrupts: Interrupts) -> tuple[Shards, Checkpoints]:
    """A job as its checkpoints left it."""
    checkpoints = Checkpoints(folder)
    shards = build_shards(config, checkpoints.sizes)
    checkpoints.attach(shards, {}, interrupts, 1000.0)
    for trainer, saver in zip(shards.trainers, checkpoints.savers, strict=True):
        trainer.on_iteration = saver
    return shards, checkpoints


@pytest.mark.parametrize("threads", [(1, 2), (2, 1), (2, 3)])
@pytest.mark.parametrize("name", ["per trial", "learns from data"])
def test_an_interrupted_job_goes_on_with_other_threads(name, threads, tmp_path, monkeypatch):
    expected = straight(name, tmp_path / "one")
    monkeypatch.setattr(module, "LARGEST", 3)
    monkeypatch.setattr(module, "SMALLEST", 2)
    first, second = threads
    job = tmp_path / "job"
    job.mkdir()
    interrupts = Interrupts(lambda: None)
    shards, checkpoints = begin(composed(name, f"threads={first}"), job, interrupts)
    sizes = [len(trainer.trials) for trainer in shards.trainers]
    assert len(sizes) > 2
    saver = checkpoints.savers[1]

    def stop(trials) -> None:
        if trials.iteration == 4:
            interrupts.pending = Interrupted(signal.SIGINT)
        saver(trials)

    shards.trainers[1].on_iteration = stop
    with pytest.raises(Interrupted):
        shards.run(first)
    assert saver.saved == 4
    seconds = shards.seconds
    config = composed(name, f"threads={second}")
    again, checkpoints = begin(config, job, Interrupts(lambda: None))
    assert [len(trainer.trials) for trainer in again.trainers] == sizes
    reached = [trainer.trials.iteration for trainer in shards.trainers]
    assert [saver.saved for saver in checkpoints.savers] == reached
    if first == 1:  # the first shard has been trained to its end, the last one not begun
        assert not again.trainers[0].trials.active.any()
        assert reached[-1] == 0
    assert again.seconds == pytest.approx(seconds, abs=0.5)
    again.run(second)
    assert files(config, again, job) == expected
    checkpoints.clear()
    assert not (job / "checkpoint").exists()


@pytest.mark.parametrize("damaged", [0, 1])
def test_a_damaged_shard_starts_over_and_the_others_resume(damaged, tmp_path, monkeypatch, caplog):
    name = "per trial"
    expected = straight(name, tmp_path / "one")
    job = tmp_path / "job"
    job.mkdir()
    monkeypatch.setattr(module, "SMALLEST", 2)
    config = composed(name, "threads=2")
    shards, _ = begin(config, job, Interrupts(lambda: None))
    shards.run(2)
    for path in (job / "checkpoint" / str(damaged)).glob("?.safetensors"):
        path.write_bytes(path.read_bytes()[:-3])
    again, checkpoints = begin(config, job, Interrupts(lambda: None))
    assert "its trials start over" in caplog.text
    assert checkpoints.sizes == [4, 5]
    iterations = [trainer.trials.iteration for trainer in again.trainers]
    assert [n == 0 for n in iterations] == [k == damaged for k in range(2)]
    again.run(2)
    assert files(config, again, job) == expected


def break_off(config, job: Path) -> None:
    """Send a signal while both threads are busy with an iteration that does not end."""
    release = threading.Event()
    with Interrupts(lambda: None) as interrupts:
        shards, checkpoints = begin(config, job, interrupts)
        for trainer in shards.trainers:

            def slow(active, trainer=trainer, collect=trainer.collector.collect):
                if trainer.trials.iteration == 3:
                    if trainer is shards.trainers[0]:
                        os.kill(os.getpid(), signal.SIGINT)
                    release.wait(60)
                return collect(active)

            trainer.collector.collect = slow
        started = time.monotonic()
        try:
            with interrupts.deferred():
                shards.run(2)
        finally:
            assert time.monotonic() - started < 20
            checkpoints.rescue()
            release.set()  # what they do from here on must not be seen


def test_a_signal_breaks_off_slow_iterations_of_two_threads(tmp_path, monkeypatch):
    """The main thread does not wait for them: it writes the states that they began with."""
    name = "per trial"
    expected = straight(name, tmp_path / "one")
    monkeypatch.setattr(module, "SMALLEST", 2)
    monkeypatch.setattr(resume, "SLOW", -1.0)
    job = tmp_path / "job"
    job.mkdir()
    config = composed(name, "threads=2")
    with pytest.raises(Interrupted):
        break_off(config, job)
    for thread in threading.enumerate():
        if thread is not threading.main_thread():
            thread.join(5)
    again, _ = begin(config, job, Interrupts(lambda: None))
    saved = [trainer.trials.iteration for trainer in again.trainers]
    assert saved[0] == 3
    assert 0 < saved[1] <= 3
    again.run(2)
    assert files(config, again, job) == expected


def test_two_threads_train_at_the_same_time(monkeypatch):
    """Each waits within an iteration until the other one is there."""
    monkeypatch.setattr(module, "SMALLEST", 2)
    shards = build_shards(composed("stopped by evaluation", "threads=2"))
    meeting = threading.Barrier(2, timeout=60)
    for trainer in shards.trainers:
        trainer.on_iteration = lambda trials: trials.iteration == 1 and meeting.wait()
    assert len(shards.run(2)) == TRIALS
    assert not meeting.broken
    assert np.isfinite(shards.trials().score).all()
