"""One override moves a sweep to other processes; its files and its last words stay the same."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from trl_explore.config import CONF, sweeping
from trl_explore.jobs import sweep_files
from trl_explore.jobs.console import Progress
from trl_explore.jobs.lock import Lock

SWEEP = [
    "-m", "experiment=debug", "strategy=epsilon_greedy", "strategy.epsilon=0.1,2,0.4,0.10",
    "trials=2", "max_iterations=12", "score_threshold=60", "threads=2",
]  # fmt: skip
PLUGINS = {
    "joblib": "hydra_plugins.hydra_joblib_launcher",
    "submitit_local": "hydra_plugins.hydra_submitit_launcher",
    "ray": "hydra_plugins.hydra_ray_launcher",
}
WRONG = re.compile(r"strategy: epsilon.*\[0, 1\].*2$")


def installed(package: str) -> bool:
    try:
        return importlib.util.find_spec(package) is not None
    except ModuleNotFoundError:
        return False


def payload(job: Path) -> dict[str, bytes]:
    """Every file of a job to the byte, without wall-clock times and Hydra's own."""
    files = {
        str(path.relative_to(job)): path.read_bytes()
        for path in sorted(job.rglob("*"))
        if path.is_file() and path.name != "run.json" and ".hydra" not in path.parts
    }
    rows = [line.split(",") for line in files["trials.csv"].decode().splitlines()]
    place = rows[0].index("seconds")
    files["trials.csv"] = repr([row[:place] + row[place + 1 :] for row in rows]).encode()
    return files


def table(stdout: str) -> list[list[str]]:
    """The rows of the table, without the seconds."""
    return [line.split()[:-1] for line in stdout.splitlines() if line.startswith("epsilon_greedy")]


@pytest.fixture(scope="module")
def serial(tmp_path_factory, run_many):
    place = tmp_path_factory.mktemp("serial")
    (ran,) = run_many([SWEEP], place)
    return ran, place / "outputs" / "debug"


@pytest.fixture(scope="module", params=PLUGINS)
def parallel(request, tmp_path_factory, run_cli):
    if not installed(PLUGINS[request.param]):
        pytest.skip(f"the extra of hydra/launcher={request.param} is not installed")
    place = tmp_path_factory.mktemp(request.param)
    workers = ["hydra.launcher.n_jobs=2"] if request.param == "joblib" else []
    ran = run_cli(*SWEEP, f"hydra/launcher={request.param}", *workers, cwd=place)
    return ran, place / "outputs" / "debug"


def test_the_files_are_those_of_the_serial_sweep(serial, parallel):
    names = [sorted(p.name for p in sweep.iterdir() if p.name != ".submitit")
             for _, sweep in (serial, parallel)]  # fmt: skip
    assert names[0] == names[1]
    for name in ("epsilon_greedy,epsilon=0.1", "epsilon_greedy,epsilon=0.4"):
        (job,) = (p for p in serial[1].iterdir() if p.name.startswith(name))
        other = parallel[1] / job.name
        assert payload(other) == payload(job)
        runs = [json.loads((path / "run.json").read_text()) for path in (job, other)]
        for run in runs:
            del run["seconds"]
            del run["files"]["trials.csv"]  # whose digest is also one of its seconds
        assert runs[0] == runs[1]
        assert runs[1]["threads"] == {"compiled": 2, "torch": 1}


def test_the_end_of_the_sweep_tells_the_same(serial, parallel):
    """A value that is named twice is one job; a job that fails does not stop the others."""
    first, second = serial[0], parallel[0]
    assert (first.returncode, second.returncode) == (1, 1)
    assert table(second.stdout) == table(first.stdout)
    assert len(table(second.stdout)) == 2
    errors = [
        [line for line in ran.stderr.splitlines() if not line.startswith("collector: ")]
        for ran in (first, second)
    ]
    assert errors[0] == errors[1]
    assert errors[0][0].startswith("error: epsilon_greedy,epsilon=2.0")
    assert WRONG.search(errors[0][0])
    assert "1 of 3" in errors[0][1]


def test_a_failure_is_recorded_until_it_is_mended(serial, parallel):
    for _, sweep in (serial, parallel):
        (reason,) = sweep_files.read_failures(sweep).values()
        assert WRONG.match(reason)
        assert len(sweep_files.read_asked(sweep)) == 3


@pytest.mark.skipif(not installed(PLUGINS["joblib"]), reason="the extra is not installed")
def test_again_under_another_launcher(serial, run_cli, tmp_path):
    """What is finished is not run again, whoever ran it."""
    sweep = tmp_path / "outputs" / "debug"
    shutil.copytree(serial[1], sweep)
    before = {job: payload(job) for job in sweep.iterdir() if (job / "run.json").exists()}
    times = {job: (job / "run.json").stat().st_mtime_ns for job in before}
    again = [word.replace("0.1,2,0.4,0.10", "0.4,0.1") for word in SWEEP]
    ran = run_cli(*again, "hydra/launcher=joblib", "hydra.launcher.n_jobs=2", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.count("restart=true") == 2
    assert [row[0].split(",")[1] for row in table(ran.stdout)[-2:]] == [
        "epsilon=0.4", "epsilon=0.1",
    ]  # fmt: skip
    assert {job: payload(job) for job in before} == before
    assert {job: (job / "run.json").stat().st_mtime_ns for job in before} == times


# What is read from the files


def sweep_of(folder: Path, *names: str) -> sweeping.Sweep:
    """The callback after it has planned jobs of these names."""
    sweep = sweeping.Sweep()
    sweep.place, sweep.folders = folder, [folder / name for name in names]
    sweep_files.begin_sweep(folder, list(dict.fromkeys(names)))
    return sweep


def finish(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").write_text("{}")


def collect(sweep: sweeping.Sweep, launch) -> list[sweeping.Ended]:
    def start() -> None:
        sweeping.Process.sweep = sweep
        launch()

    try:
        return sweeping.collect(start)
    finally:
        sweeping.Process.leads = False


def test_a_launcher_that_breaks_loses_no_finished_job(tmp_path, capsys):
    """A worker that was killed takes the launcher with it; the files say which jobs ended."""

    def launch():
        finish(tmp_path / "a")
        sweep_files.record_failure(tmp_path / "b", "wrong")
        raise RuntimeError("a worker was killed\nmore")

    ended = collect(sweep_of(tmp_path, *"abc"), launch)
    assert [(job.folder.name, job.error) for job in ended] == [
        ("a", ""),
        ("b", "wrong"),
        ("c", ended[2].error),
    ]
    assert "RuntimeError: a worker was killed" in ended[2].error
    assert [line.split(":")[1] for line in capsys.readouterr().err.splitlines()] == [" b", " c"]
    assert sweep_files.read_asked(tmp_path) == ["a", "b", "c"]


def test_a_job_without_a_word_is_in_use_or_was_cut_off(tmp_path, capsys):
    with Lock(tmp_path / "b"):
        cut, used = collect(sweep_of(tmp_path, *"ab"), lambda: None)
    assert cut.error == "cut off; run the same command to resume"
    assert used.error == f"{tmp_path / 'b'} is in use: another process runs this job"
    assert capsys.readouterr().err.count("error: ") == 2


def test_what_this_process_has_said_is_said_once(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sweeping, "is_multirun", lambda: True)
    sweep = sweep_of(tmp_path, *"aba")
    jobs = collect(sweep, lambda: sweeping.end_job(tmp_path / "a", "wrong", record=False))
    assert [job.folder.name for job in jobs] == ["a", "b"]
    assert capsys.readouterr().err.splitlines()[0] == "error: a: wrong"


def test_a_job_that_equals_an_earlier_one_is_repeated(tmp_path):
    sweep, seen = sweep_of(tmp_path, *"aba"), []
    sweep.jobs, sweep.repeated = 3, {2}
    for number in (0, 1, 2, 3, "???"):
        sweep.on_job_start(OmegaConf.create({"hydra": {"job": {"num": number}}}))
        seen.append(sweeping.Process.repeated)
    assert seen == [False, False, True, False, False]


def test_a_finished_sweep_leaves_no_list(tmp_path):
    """So that a sweep that was interrupted ends with the same files as one that was not."""
    collect(sweep_of(tmp_path, "a"), lambda: finish(tmp_path / "a"))
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("name", ["joblib", "submitit_local", "submitit_slurm", "ray"])
def test_a_launcher_that_is_not_installed_is_one_line(name, monkeypatch):
    launcher = OmegaConf.load(CONF / "hydra" / "launcher" / f"{name}.yaml")
    hydra = {
        "launcher": launcher,
        "sweeper": {"_target_": "hydra._internal.core_plugins.basic_sweeper.BasicSweeper"},
        "runtime": {"choices": {"hydra/launcher": name, "hydra/sweeper": "basic"}},
    }
    monkeypatch.setitem(sys.modules, launcher._target_.rpartition(".")[0], None)
    line = sweeping._not_installed(OmegaConf.create({"hydra": hydra}))
    assert line.startswith(f"hydra/launcher={name} is not installed: pip install 'trl_explore[")


@pytest.mark.skipif(installed(PLUGINS["ray"]), reason="the extra is installed")
def test_what_is_not_installed_ends_before_any_job(run_many, tmp_path):
    (ran,) = run_many([["-m", "experiment=debug", "trials=1,2", "hydra/launcher=ray"]], tmp_path)
    assert (ran.returncode, ran.stdout) == (1, "")
    assert ran.stderr.splitlines() == [
        "error: hydra/launcher=ray is not installed: pip install 'trl_explore[ray]'"
    ]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["joblib", "submitit_local", "submitit_slurm"])
def test_the_ready_files_say_every_argument_of_their_plugin(name):
    """Hydra checks them against the plugin's own schema when they are composed."""
    plugin = "joblib" if name == "joblib" else "submitit"
    module = f"hydra_plugins.hydra_{plugin}_launcher.{'config' if plugin == 'submitit' else 'x'}"
    if plugin == "joblib":
        module = "hydra_plugins.hydra_joblib_launcher.config"
    schemas = pytest.importorskip(module)
    kind = {
        "joblib": "JobLibLauncherConf", "submitit_local": "LocalQueueConf",
        "submitit_slurm": "SlurmQueueConf",
    }[name]  # fmt: skip
    schema = OmegaConf.structured(getattr(schemas, kind))
    ours = OmegaConf.load(CONF / "hydra" / "launcher" / f"{name}.yaml")
    assert set(ours) == set(schema)
    assert ours._target_ == schema._target_


def test_progress_is_quiet_in_a_process_among_others(monkeypatch):
    class Terminal:
        def isatty(self) -> bool:
            return True

    assert Progress("x", [], Terminal()).live
    monkeypatch.setattr(Progress, "quiet", True)
    assert not Progress("x", [], Terminal()).live


def test_a_worker_has_no_leader():
    """What says who leads does not travel: a fresh interpreter that imports it does not lead."""
    code = "import sys, trl_explore.config.sweeping as s; print(not s.Process.leads, *sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    worker, *modules = done.stdout.split()
    assert worker == "True"
    assert "torch" not in modules
