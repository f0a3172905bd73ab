"""The jobs of a sweep are composed from files that are read once."""

from __future__ import annotations

import errno
import os
import pickle
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.utils import JobReturn
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import OmegaConf

from trl_explore import config as configuration
from trl_explore.config import hydra_plugins, sweeping
from trl_explore.config.files import CONF
from trl_explore.config.hydra_plugins import Composer
from trl_explore.jobs import sweep_files

JOBS = [
    "",
    "seed=3 strategy.temperature=1",
    "strategy=epsilon_greedy strategy.epsilon=0.2",
    "strategy=argmax",
    "+schedule@strategy.temperature=linear strategy.temperature.initial=5",
    "correction=as_if strategy@correction.strategy=argmax",
    "experiment=why strategy=softmax correction=per_step",
    "env=frozenlake policy=tabular +env.kwargs.is_slippery=false",
    "env=gym env.id=Acrobot-v1",
    "~experiment ~strategy.temperature",
    "hydra.job.name=mine hydra.sweep.subdir=x",
    "+env.attributes={gravity:3.7} score_threshold=100.0",
]
WRONG = ["seed=3,4", "foo=1", "strategy=nope", "strategy.nope=2", "~nope", "seed=[1"]


@pytest.fixture(scope="module")
def loader() -> Iterator[Any]:
    configuration.register_resolvers()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        yield GlobalHydra.instance().config_loader()


@pytest.fixture(scope="module")
def master(loader) -> Any:
    return loader.load_configuration("train", ["output_dir=here", "seed=7"], RunMode.MULTIRUN)


def test_jobs_are_those_of_hydra(loader, master):
    composer = Composer(loader)
    for text in [*JOBS, *reversed(JOBS)]:  # what one job changes must not reach another
        expected = loader.load_sweep_config(master, text.split())
        job = composer(master, text.split())
        assert OmegaConf.to_container(job) == OmegaConf.to_container(expected), text
        job.seed = 99


@pytest.mark.parametrize("text", WRONG)
def test_errors_are_those_of_hydra(loader, master, text):
    with pytest.raises(HydraException) as expected:
        loader.load_sweep_config(master, [text])
    with pytest.raises(HydraException) as error:
        Composer(loader)(master, [text])
    assert str(error.value) == str(expected.value)


def test_files_are_read_once_for_each_choice_of_options(loader, master, monkeypatch):
    read = []
    load = type(loader).load_sweep_config

    def note(self, master, words):
        read.append(words)
        return load(self, master, words)

    monkeypatch.setattr(type(loader), "load_sweep_config", note)
    composer = Composer(loader)
    for seed in range(4):
        for strategy in ("softmax", "argmax"):
            composer(master, [f"strategy={strategy}", f"seed={seed}"])
    assert read == [["strategy=softmax"], ["strategy=argmax"]]


def test_a_launcher_may_send_it_to_another_process(loader, master):
    composer = Composer(loader)
    composer(master, ["seed=4"])
    again = pickle.loads(pickle.dumps(composer))
    assert again(master, ["seed=4"]) == composer(master, ["seed=4"])


@pytest.mark.parametrize("module", ["joblib.externals.loky.process_executor", "elsewhere"])
def test_a_thread_of_joblib_prints_no_traceback(module, capsys, monkeypatch):
    def fail() -> None:
        raise KeyError(17)

    monkeypatch.setattr(threading, "excepthook", sweeping._in_thread)
    thread = type("Manager", (threading.Thread,), {"__module__": module})(target=fail)
    thread.start()
    thread.join()
    assert ("Traceback" in capsys.readouterr().err) == (module == "elsewhere")


def test_jobs_that_were_not_planned_are_those_that_the_launcher_returns(tmp_path, monkeypatch):
    """However old their files are: a repeated search finds its jobs finished."""

    class Launcher:
        def launch(self, names):
            ended = [JobReturn() for _ in names]
            for name, returned in zip(names, ended, strict=True):
                folder = {"hydra": {"runtime": {"output_dir": str(tmp_path / name)}}}
                sweeping.Sweep().on_job_end(OmegaConf.create(folder), job_return=returned)
            return [*ended, hydra_plugins._ended()]  # the cluster has ended the last one

    monkeypatch.setattr(hydra_plugins, "get_class", lambda name: Launcher)
    for _ in range(2):  # noted once, however many sweeps the process has run
        noted = []
        hydra_plugins.note_folders("a launcher", noted.append, 500.0)
        assert Launcher().launch("ab")[2].return_value == 500.0
        assert noted == [tmp_path / "a", tmp_path / "b"]


def test_a_search_whose_processes_are_killed(tmp_path):
    """A job that the cluster has ended is counted; if the launcher fails, one line says so."""
    sweep = sweeping.Sweep()
    sweep.searches, sweep.place = True, tmp_path / "sweep"
    (tmp_path / "sweep" / "a").mkdir(parents=True)
    (tmp_path / "sweep" / "a" / "run.json").touch()

    def start():
        sweeping.Process.sweep = sweep
        sweeping.Process.launched.append(tmp_path / "sweep" / "a")
        sweeping.Process.reasons.extend(["", "Ray ended the job (NodeDiedError)"])

    def fail():
        start()
        raise RuntimeError("a worker was killed")

    ended = sweeping.collect(start)
    assert [(job.folder.name, job.error) for job in ended] == [
        ("a", ""), ("sweep", "Ray ended the job (NodeDiedError)"),
    ]  # fmt: skip
    with pytest.raises(configuration.ConfigError, match=r"launcher failed.*a worker was killed"):
        sweeping.collect(fail)


def test_a_reason_is_recorded_although_another_job_removes_the_empty_folder(tmp_path, monkeypatch):
    write, folders = sweep_files.write_whole, []

    def late(path, *arguments, **options):
        if not folders:
            folders.append(path.parent)
            sweep_files.forget_failure(tmp_path / "other")
        write(path, *arguments, **options)

    monkeypatch.setattr(sweep_files, "write_whole", late)
    sweep_files.record_failure(tmp_path / "job", "no memory")
    assert folders
    assert sweep_files.read_failures(tmp_path) == {"job": "no memory"}


def test_a_reason_that_a_worker_cannot_record_is_printed(tmp_path, monkeypatch, capsys):
    def full(path, data, tag=""):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr(sweep_files, "write_whole", full)
    monkeypatch.setattr(sweeping, "is_multirun", lambda: True)
    monkeypatch.setattr(sweeping.Process, "leads", False)
    (tmp_path / "sweep" / "other").mkdir(parents=True)
    sweeping.end_job(tmp_path / "sweep" / "job", "cannot write a file")
    assert capsys.readouterr().err == "error: job: cannot write a file\n"
    sweep_files.forget_failure(tmp_path / "sweep" / "job")
    assert [path.name for path in (tmp_path / "sweep").iterdir()] == ["other"]


def test_a_full_disk_is_told_with_the_name_of_the_file(tmp_path, monkeypatch, master):
    def full(path, *arguments, **options):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(sweeping.HydraConfig, "instance", lambda: SimpleNamespace(cfg=master))
    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*config\.yaml'"):
        sweeping.save_hydra(tmp_path, OmegaConf.create({}))


def test_what_a_launcher_sends_with_each_job_does_not_grow_with_the_sweep():
    sweep = sweeping.Sweep()
    sweep.folders, sweep.jobs = [Path(f"/sweep/{n}") for n in range(1000)], 1000
    assert pickle.loads(pickle.dumps(sweep)).jobs == 1000
    assert len(pickle.dumps(sweep)) < 500


def test_an_error_of_this_attempt_alone_is_not_recorded(tmp_path, monkeypatch):
    """Another process that runs the job records the outcome."""
    monkeypatch.setattr(sweeping, "is_multirun", lambda: True)
    (tmp_path / "sweep" / "another job").mkdir(parents=True)
    for name, record in (("in use", False), ("failed", True)):
        sweeping.end_job(tmp_path / "sweep" / name, name, record=record)
    assert sweep_files.read_failures(tmp_path / "sweep") == {"failed": "failed"}
