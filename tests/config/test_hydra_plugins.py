"""A sweep on a cluster waits for all its jobs; ``tests/engines`` does so on real clusters."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from trl_explore.config import hydra_plugins

SLURM = "hydra_plugins.hydra_submitit_launcher.submitit_launcher.SlurmLauncher"


class Job:
    """A job of submitit that has ended in ``state``, with a result or an error."""

    def __init__(self, place: Path, state: str, error: Exception | None = None, result=None):
        self.state, self.error, self.result = state, error, result
        self.paths = SimpleNamespace(result_pickle=place)
        self.waited = False

    def wait(self):
        self.waited = True

    def exception(self):
        return self.error

    def results(self):
        return [self.result]


@pytest.fixture
def submitit(monkeypatch):
    """The module, whose patches end with the test."""
    submitit = pytest.importorskip("submitit")
    slurm = pytest.importorskip("submitit.slurm.slurm")
    monkeypatch.setattr(submitit.AutoExecutor, "map_array", submitit.AutoExecutor.map_array)
    monkeypatch.setattr(slurm.SlurmJob, "watcher", slurm.SlurmJob.watcher)
    return submitit


def test_every_job_is_awaited_however_the_first_ends(submitit, tmp_path, monkeypatch):
    missing, done = tmp_path / "missing", tmp_path / "result"
    done.touch()
    trace = (
        f"Job (task=0) failed during processing with trace:\n{'-' * 22}\nTraceback:\n  line\n"
        f"ModuleNotFoundError: No module named 'trl_explore'\n\n{'-' * 22}\nfull logs\n  - a"
    )
    jobs = [
        Job(missing, "CANCELLED"),
        Job(done, "UNKNOWN", result="returned"),
        Job(missing, hydra_plugins.GONE),
        Job(done, "FAILED", error=RuntimeError(trace)),
    ]
    monkeypatch.setattr(hydra_plugins, "ARRAY", 3)  # four jobs are two arrays
    submitit.AutoExecutor.map_array = lambda executor, run, *arguments: [
        jobs[place] for place, word in zip(*arguments, strict=True) if run == word == "run"
    ]
    reasons: list[str] = []
    hydra_plugins.await_all(SLURM, lambda reason: pytest.fail("of an earlier sweep"))
    hydra_plugins.await_all(SLURM, reasons.append)
    started = submitit.AutoExecutor.map_array(None, "run", range(4), ["run"] * 4)
    returned = [job.results()[0] for job in started]
    assert all(job.waited for job in jobs)
    assert returned[1] == "returned"
    assert [job.return_value for job in (returned[0], *returned[2:])] == [None] * 3
    assert reasons == [
        "the job ended without a result (CANCELLED)",
        "",
        "the job ended without a result (no longer in the queue)",
        "ModuleNotFoundError: No module named 'trl_explore'",
    ]


def test_the_states_of_jobs_are_those_of_the_queue(submitit):
    hydra_plugins.await_all(SLURM, lambda reason: None)
    watcher = submitit.slurm.slurm.SlurmJob.watcher
    for job in ("7_0", "7_1", "7_2", "7_3"):
        watcher.register_job(job)
    command = watcher._make_command()
    assert command[0] == "squeue"
    assert "--states=all" in command
    listed = "7_0|RUNNING\n7_1|CANCELLED\n7_2|CONFIGURING\n9|FAILED\n"
    watcher._info_dict = watcher.read_info(listed)
    done = [watcher.is_done(f"7_{n}", mode="cache") for n in range(4)]
    assert done == [False, True, False, True]
    watcher._finished = set(watcher._registered)
    assert watcher._make_command() is None


def test_another_launcher_is_left_alone(monkeypatch):
    monkeypatch.setattr(hydra_plugins, "_await_submitit", pytest.fail)
    monkeypatch.setattr(hydra_plugins, "_await_ray", pytest.fail)
    hydra_plugins.await_all(
        "hydra._internal.core_plugins.basic_launcher.BasicLauncher", pytest.fail
    )


def test_each_job_is_composed_twice_to_plan_it_and_to_run_it(run_many, tmp_path):
    count = """
from pathlib import Path
from trl_explore.config.hydra_plugins import Composer
compose = Composer.__call__
def counted(self, *words, **more):
    with Path("composed").open("a") as file:
        file.write("*")
    return compose(self, *words, **more)
Composer.__call__ = counted
"""
    (ended,) = run_many(
        [count, ["-m", "trials=0", "seed=1,2,3", f"output_dir={tmp_path}"]], tmp_path
    )
    assert "3 of 3 jobs failed" in ended.stderr
    assert (tmp_path / "composed").read_text() == "*" * 6
