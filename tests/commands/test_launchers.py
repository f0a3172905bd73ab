"""One override moves a sweep to other processes; its files and its last words stay the same."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from hydra.core.plugins import Plugins
from omegaconf import OmegaConf

from trl_explore.config import CONF, ConfigError, sweeping
from trl_explore.jobs import sweeps
from trl_explore.jobs.console import Progress

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
        (reason,) = sweeps.read_failures(sweep).values()
        assert WRONG.match(reason)
        assert len(sweeps.read_asked(sweep)) == 3


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


# The collecting itself


class Sweeper:
    """What a sweeper has; ``launch`` is what its launcher does."""

    def __init__(self, folder: Path, launch) -> None:
        self.config = OmegaConf.create({"hydra": {"sweep": {"dir": str(folder)}}})
        self.launcher = SimpleNamespace(launch=launch)
        self.hydra_context = SimpleNamespace(config_loader=self)

    def load_sweep_config(self, config, overrides):
        return OmegaConf.merge(config, {"hydra": {"sweep": {"subdir": overrides[0]}}})


@pytest.fixture
def leading(monkeypatch):
    monkeypatch.setattr(sweeping._State, "leads", True)
    monkeypatch.setattr(sweeping._State, "ended", [], raising=False)


def finish(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").write_text("{}")


def test_a_launcher_that_breaks_loses_no_finished_job(tmp_path, leading, capsys):
    """A worker that was killed takes the launcher with it; the files say which jobs ended."""

    def launch(batch, first):
        finish(tmp_path / "a")
        sweeps.record_failure(tmp_path / "b", "wrong")
        raise RuntimeError("a worker was killed\nmore")

    ended: list = []
    watch = sweeping._Watch(Sweeper(tmp_path, launch), ended)
    assert watch.launch([["a"], ["b"], ["c"]], 0) == []
    assert [(job.folder.name, job.error) for job in ended] == [
        ("a", ""),
        ("b", "wrong"),
        ("c", ended[2].error),
    ]
    assert "RuntimeError: a worker was killed" in ended[2].error
    assert [line.split(":")[1] for line in capsys.readouterr().err.splitlines()] == [" b", " c"]
    assert sweeps.read_asked(tmp_path) == ["a", "b", "c"]


def test_what_is_named_twice_is_launched_once(tmp_path, leading):
    launched = []

    def launch(batch, first):
        launched.extend(batch)
        return [SimpleNamespace(return_value=sweeping.Ended(tmp_path / b[0])) for b in batch]

    def load(config, overrides):
        return OmegaConf.merge(config, {"hydra": {"sweep": {"subdir": overrides[0][0]}}})

    sweeper = Sweeper(tmp_path, launch)
    sweeper.load_sweep_config = load
    returned = sweeping._Watch(sweeper, []).launch([["a"], ["ab"], ["b"]], 0)
    assert launched == [["a"], ["b"]]
    assert [r.return_value.folder.name for r in returned] == ["a", "a", "b"]


def test_a_finished_sweep_leaves_no_list(tmp_path, leading):
    """So that a sweep that was interrupted ends with the same files as one that was not."""

    def launch(batch, first):
        assert sweeps.read_asked(tmp_path) == ["a"]
        finish(tmp_path / "a")
        return [SimpleNamespace(return_value=sweeping.Ended(tmp_path / "a"))]

    sweeping._Watch(Sweeper(tmp_path, launch), []).launch([["a"]], 0)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_the_plugins_of_hydra_are_left_as_they_were(monkeypatch):
    before = dict(vars(Plugins.instance()))
    monkeypatch.setattr(sweeping._State, "leads", False)
    with sweeping.collecting():
        assert not sweeping.is_worker()
    assert dict(vars(Plugins.instance())) == before


@pytest.mark.parametrize("name", ["joblib", "submitit_local", "submitit_slurm", "ray"])
def test_a_launcher_that_is_not_installed_is_one_line(name):
    config = OmegaConf.load(CONF / "hydra" / "launcher" / f"{name}.yaml")
    choices = {"hydra/launcher": name, "hydra/sweeper": "basic"}
    whole = OmegaConf.create({"hydra": {"launcher": config, "runtime": {"choices": choices}}})
    line = sweeping._not_installed(whole, RuntimeError("Unknown plugin class : 'x'"))
    assert line.startswith(f"hydra/launcher={name}")
    assert "pip install 'trl_explore[" in line


def test_what_is_not_installed_ends_before_any_job(monkeypatch, tmp_path):
    plugins = Plugins.instance()
    config = OmegaConf.create(
        {
            "hydra": {
                "sweeper": {"_target_": "hydra_plugins.nothing.Sweeper"},
                "launcher": {"_target_": "hydra_plugins.nothing.Launcher"},
                "runtime": {"choices": {"hydra/launcher": "x", "hydra/sweeper": "y"}},
            }
        }
    )
    with sweeping.collecting(), pytest.raises(ConfigError, match="hydra/launcher=x"):
        plugins.instantiate_sweeper(config=config, hydra_context=None, task_function=None)


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

    assert Progress("x", Terminal()).live
    monkeypatch.setattr(Progress, "quiet", True)
    assert not Progress("x", Terminal()).live


def test_a_worker_has_no_leader():
    """What says who leads does not travel: a fresh interpreter that imports it does not lead."""
    code = "import sys, trl_explore.config as c; print(c.is_worker(), *sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    worker, *modules = done.stdout.split()
    assert worker == "True"
    assert "torch" not in modules
