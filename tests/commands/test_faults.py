"""What a night may bring: signals, failing jobs, full disks, damaged files."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from trl_explore.jobs.lock import Lock, LockedError, is_locked

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "train.py"

# A cart-pole that does what stands in a file, at a step that stands there too, once.
FRAGILE = """
import os, resource, signal, time
from pathlib import Path
import gymnasium
from gymnasium.envs.classic_control.cartpole import CartPoleEnv

PLAN = Path("plan.txt")

class Fragile(CartPoleEnv):
    def step(self, action):
        if PLAN.exists():
            left, what = PLAN.read_text().split()
            if int(left) > 0:
                PLAN.write_text(f"{int(left) - 1} {what}")
            else:
                PLAN.unlink()
                globals()[what]()
        return super().step(action)

def fail():
    raise RuntimeError("the simulator broke")

def term():
    os.kill(os.getpid(), signal.SIGTERM)

def hang():
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(60)

def full():  # no file may have more than so many bytes
    resource.setrlimit(resource.RLIMIT_FSIZE, (2500, resource.RLIM_INFINITY))

gymnasium.register("Fragile-v0", entry_point=Fragile, max_episode_steps=50)
"""
ROOM = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
"""
JOB = [
    "experiment=debug", "env=gym", "env.id=fragile:Fragile-v0", "collector=torchrl",
    "score_threshold=1e9", "max_iterations=12", "checkpoint_seconds=0",
]  # fmt: skip
SWEEP = ["-m", *JOB, "strategy=softmax,argmax,random"]


def plan(steps: int, what: str) -> str:
    """Python that lets something happen after so many steps; the first job takes 1182 of them."""
    return f"from pathlib import Path; Path('plan.txt').write_text('{steps} {what}')"


def copy(source: str, target: str) -> str:
    return f"import shutil; shutil.copytree('{source}/debug', '{target}/debug')"


def python(text: str) -> str:
    return f"from pathlib import Path\n{text}"


NEWEST = """
def newest(place):
    return max(Path(place).rglob("[ab].safetensors"), key=lambda path: path.stat().st_mtime_ns)
"""
CUT = NEWEST + "path = newest('{0}'); path.write_bytes(path.read_bytes()[:-9])"
CUT_ALL = "for path in Path('{0}').rglob('[ab].safetensors'): path.write_bytes(b'')"
HOLD = """
import sys
from trl_explore.jobs.lock import Lock
(folder,) = Path('{0}/debug').glob('*argmax*')
sys.held = Lock(folder).__enter__()
"""
LATE = """
import os, signal, time
from trl_explore.jobs import signals, writing
signals.PATIENCE, write = 0.01, writing.write_whole
def slowly(path, data):
    writing.write_whole = write
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(0.05)
    write(path, data)
writing.write_whole = slowly
"""
SNAPSHOT = """
import json
def seen():
    return {{str(p): [p.stat().st_mtime_ns, p.read_bytes().hex()]
            for p in sorted(Path('{0}').rglob('*')) if p.is_file() and p.name != 'multirun.yaml'}}
Path('{1}').write_text(json.dumps(seen()))
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("faults")
    (place / "fragile.py").write_text(FRAGILE)
    return place


@pytest.fixture(scope="module")
def ran(place, run_many):
    """Everything that happens, in one process; by name what each command said."""
    jobs: dict[str, list[str]] = {}
    steps: list[str | list[str]] = []

    def do(name: str, *arguments: str, into: str) -> None:
        jobs[name] = [*arguments, f"output_dir={into}"]
        steps.append("import logging; logging.getLogger().handlers.clear()")  # of the one before
        steps.append(jobs[name])

    do("straight", *SWEEP, into="straight")
    steps.append(plan(1500, "fail"))
    do("failed", *SWEEP, into="failing")
    do("retried", *SWEEP, into="failing")
    steps.append(plan(1500, "term"))
    do("terminated", *SWEEP, into="signal")
    steps += [copy("signal", "cut"), copy("signal", "anew"), copy("signal", "held")]
    steps += [copy("signal", "other")]
    do("went on", *SWEEP, into="signal")
    steps.append(plan(1500, "hang"))
    do("hung", *SWEEP, into="hang")
    do("after hanging", *SWEEP, into="hang")
    steps.append(python(CUT.format("cut")))
    do("cut", *SWEEP, into="cut")
    steps.append(python(CUT_ALL.format("anew")))
    do("anew", *SWEEP, into="anew")
    steps.append(python(HOLD.format("held")))
    steps.append(python(SNAPSHOT.format("held", "before.json")))
    do("locked", *JOB, "strategy=argmax", into="held")
    steps.append(python(SNAPSHOT.format("held", "after.json")))
    steps.append("import sys; sys.held.release()")
    do("free again", *SWEEP, into="held")
    other = "hydra.run.dir='${output_dir}/debug/" + name_of("argmax") + "'"
    steps.append(python(SNAPSHOT.format("other", "before2.json")))
    do("changed", *JOB, "strategy=argmax", "seed=7", other, into="other")
    steps.append(python(SNAPSHOT.format("other", "after2.json")))
    do("changed anew", *JOB, "strategy=argmax", "seed=7", "restart=true", other, into="other")
    steps.append(plan(1500, "full"))
    do("full", *SWEEP, into="full")
    steps.append(ROOM)
    do("room", *SWEEP, into="full")
    spoil = (
        "path = next(Path('straight').glob('*/softmax*/episodes.csv')); data = path.read_bytes()"
    )
    steps.append(python(f"{spoil}; path.write_bytes(data[:-20])"))
    do("spoilt", *SWEEP, into="straight")
    left = "folder = next(Path('hang').rglob('run.json')).parent; (folder / '.lock').touch();"
    left += "(folder / 'checkpoint').mkdir(); (folder / 'checkpoint' / 'a.safetensors').touch()"
    steps.append(python(left))
    do("left over", *SWEEP, into="hang")
    steps.append(LATE)
    do("late", *JOB, "strategy=argmax", into="late")
    results = run_many(steps, place)
    return dict(zip(jobs, results, strict=True))


def name_of(strategy: str) -> str:
    rest = "env.id=fragile%3AFragile-v0,max_iterations=12,score_threshold=1000000000.0"
    return f"{strategy},env=gym,collector=torchrl,{rest}"


def payload(folder: Path) -> dict[str, bytes]:
    """Every file that must be the same, but ``seconds``."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_dir() or ".hydra" in path.parts or path.name in ("multirun.yaml", "run.json"):
            continue
        data = path.read_bytes()
        if path.name == "trials.csv":
            rows = [line.split(b",") for line in data.splitlines()]
            data = b"\n".join(b",".join(row[:6] + row[7:]) for row in rows)
        found[str(path.relative_to(folder))] = data
    return found


def test_no_traceback(ran):
    for name, process in ran.items():
        assert "Traceback" not in process.stderr + process.stdout, name


@pytest.fixture(scope="module")
def same(place, ran):
    """Whether a sweep ended with the files of the one that nothing happened to."""
    assert ran["straight"].returncode == 0, ran["straight"].stderr
    whole = payload(place / "signal")  # compared with a run of its own below

    def check(folder: str) -> None:
        files = payload(place / folder)
        assert set(files) == set(whole)
        assert [name for name in whole if files[name] != whole[name]] == []

    return check


def test_a_sweep_that_went_on_is_the_one_that_ran_straight_through(place, ran):
    assert ran["went on"].returncode == 0, ran["went on"].stderr
    shutil.rmtree(place / "straight" / "debug" / ".failed")  # what became of the spoilt file
    straight, again = payload(place / "straight"), payload(place / "signal")
    (spoilt,) = (name for name in straight if "softmax" in name and name.endswith("episodes.csv"))
    assert set(straight) == set(again)
    assert [name for name in straight if straight[name] != again[name]] == [spoilt]
    assert again[spoilt][:-20] == straight[spoilt]


def test_a_failing_job_is_named_and_the_others_are_run(place, ran, same):
    process = ran["failed"]
    assert process.returncode == 1
    first, summary, last = process.stderr.splitlines()
    assert first.startswith(f"error: {name_of('argmax')}: ")
    for words in ("fragile:Fragile-v0", "RuntimeError", "episode 2 of trial 2", "simulator broke"):
        assert words in first
    assert "1 of 3" in summary
    assert first.endswith(last.strip())
    assert ran["retried"].returncode == 0
    assert ran["retried"].stdout.count("restart=true") == 2
    same("failing")


def test_a_signal_in_a_sweep(place, ran):
    process = ran["terminated"]
    assert process.returncode == 143
    (line,) = process.stderr.splitlines()
    assert re.match(r"terminated.* iteration \d+ ", line)
    assert name_of("argmax") in line
    assert "same command" in line
    assert ran["went on"].stdout.count("restart=true") == 1  # the third was never started


def test_a_long_iteration_is_broken_off(ran, same):
    process = ran["hung"]
    assert process.returncode == 130
    (line,) = process.stderr.splitlines()
    assert re.match(r"interrupted.* iteration \d+ ", line)
    assert ran["after hanging"].returncode == 0
    same("hang")


def test_a_damaged_checkpoint(ran, same):
    said = []
    for name in ("cut", "anew"):
        assert ran[name].returncode == 0
        (line,) = ran[name].stderr.splitlines()
        assert re.match("damaged checkpoint.*: ", line)
        said.append(line.partition(":")[0])
        same(name)
    assert said[0] != said[1]  # going on from the one before, or from the first iteration


def test_a_second_process_refuses_and_touches_nothing(place, ran, same):
    process = ran["locked"]
    assert process.returncode == 1
    (line,) = process.stderr.splitlines()
    assert line.startswith("error: ")
    assert f"{name_of('argmax')} is in use" in line
    assert (place / "before.json").read_bytes() == (place / "after.json").read_bytes()
    assert ran["free again"].returncode == 0
    same("held")


def test_another_configuration_is_never_continued(place, ran):
    process = ran["changed"]
    assert process.returncode == 1
    (line,) = process.stderr.splitlines()
    assert name_of("argmax") in line
    assert re.search(r"seed: 0\b.*\b7\b.*restart=true", line)
    assert (place / "before2.json").read_bytes() == (place / "after2.json").read_bytes()
    assert ran["changed anew"].returncode == 0
    folder = place / "other" / "debug" / name_of("argmax")
    assert (folder / "trials.csv").read_text().splitlines()[1].startswith("0,7,12,")
    assert not (folder / "checkpoint").exists()


def test_a_full_disk_loses_no_finished_work(place, ran, same):
    process = ran["full"]
    assert process.returncode == 1
    assert re.search("checkpoint.*File too large", process.stderr)
    assert f"error: {name_of('argmax')}: " in process.stderr
    assert ran["room"].returncode == 0
    assert ran["room"].stdout.count("restart=true") == 1
    same("full")


def test_a_truncated_file_of_a_finished_job_is_named(place, ran):
    process = ran["spoilt"]
    assert process.returncode == 1
    (line, *_) = process.stderr.splitlines()
    assert re.search(r"episodes\.csv.*damaged.*restart=true", line)


def test_what_a_kill_left_beside_a_finished_job_goes(ran, same):
    assert ran["left over"].returncode == 0
    assert ran["left over"].stdout.count("restart=true") == 3
    same("hang")


# Locks


def test_a_lock_is_one_processs(tmp_path):
    folder = tmp_path / "job"
    with Lock(folder):
        assert is_locked(folder)
        with pytest.raises(LockedError, match="job is in use"):
            Lock(folder).__enter__()
        (folder / "result").touch()
    assert not is_locked(folder)
    assert [path.name for path in folder.iterdir()] == ["result"]


def test_a_folder_in_which_nothing_happened_goes_with_its_lock(tmp_path):
    with Lock(tmp_path / "job"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_goes_while_a_lock_is_taken_is_made_again(tmp_path, monkeypatch):
    """Another process released an empty folder between its making and the opening of the file."""
    folder, times, make = tmp_path / "job", [], Path.mkdir

    def made_and_gone(path, *args, **kwargs):
        make(path, *args, **kwargs)
        times.append(path)
        if len(times) == 1:
            path.rmdir()

    monkeypatch.setattr(Path, "mkdir", made_and_gone)
    with Lock(folder):
        assert is_locked(folder)
    assert times == [folder, folder]


def test_a_killed_process_gives_its_lock_back(tmp_path):
    text = (
        "import sys, time; from pathlib import Path; from trl_explore.jobs.lock import Lock\n"
        f"with Lock(Path({str(tmp_path / 'job')!r})): print('has it', flush=True); time.sleep(60)"
    )
    environment = {**os.environ, "PYTHONPATH": str(SCRIPT.parent.parent)}
    with subprocess.Popen(
        [sys.executable, "-c", text], stdout=subprocess.PIPE, env=environment
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        assert is_locked(tmp_path / "job")
        process.kill()
    assert (tmp_path / "job" / ".lock").exists()
    assert not is_locked(tmp_path / "job")
    with Lock(tmp_path / "job"):
        assert is_locked(tmp_path / "job")


def test_a_lock_whose_file_was_removed_is_not_held(tmp_path):
    """Who opened the file just before it was removed must not believe to have the lock."""
    first = Lock(tmp_path).__enter__()
    first.path.unlink()
    with Lock(tmp_path) as second:
        assert is_locked(tmp_path)
        first.path = tmp_path / "elsewhere"
        first.release()
        assert is_locked(tmp_path)
        assert second.path.exists()


# Permissions


@pytest.mark.skipif(
    os.geteuid() == 0 and shutil.which("setpriv") is None, reason="root, and no setpriv"
)
def test_a_folder_that_loses_its_permission(tmp_path):
    """Of root, the right to write anywhere is taken away first."""
    drop = "-dac_override,-dac_read_search,-fowner"
    without = ["setpriv", f"--bounding-set={drop}", f"--inh-caps={drop}"]
    command = [
        *(without if os.geteuid() == 0 else []), sys.executable, str(SCRIPT), "experiment=debug",
        "trials=300", "max_iterations=100000", "score_threshold=1e9", "checkpoint_seconds=0.1",
        f"output_dir={tmp_path / 'out'}",
    ]  # fmt: skip
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120
        while not list(tmp_path.rglob("*.safetensors")):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.02)
        (slot, *_) = tmp_path.rglob("*.safetensors")
        job = slot.parent.parent
        kept = {path: path.read_bytes() for path in job.rglob("*.safetensors")}
        for folder in (slot.parent, job):
            folder.chmod(0o555)
        try:
            assert process.stderr is not None
            lines = [process.stderr.readline() for _ in range(2)]
            process.terminate()
            lines += process.communicate(timeout=60)[1].splitlines(keepends=True)
        finally:
            for folder in (job, slot.parent):
                folder.chmod(0o755)
    text = "".join(lines)
    assert process.returncode == 143
    assert re.search("checkpoint.*Permission denied", text)
    assert re.search(r"terminated.* iteration \d+", text)
    assert "Traceback" not in text
    assert set(job.rglob("*.safetensors")) >= set(kept)
    assert not (job / "run.json").exists()


def test_a_signal_while_the_results_are_written_waits_until_they_are(ran, place):
    """However long that takes: what was trained is not lost."""
    assert ran["late"].returncode == 143
    (job,) = (place / "late" / "debug").iterdir()
    assert (job / "run.json").is_file()
    assert not (job / "checkpoint").exists()
