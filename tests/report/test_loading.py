"""Wrong input: one clear line, or a gap that is marked; never a traceback or a wrong figure."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from trl_explore.jobs.files import ResultsError
from trl_explore.report.loading import UNFINISHED, load
from trl_explore.report.writing import build_report

WITHOUT_TORCH = """
import runpy, sys
try:
    runpy.run_path(sys.argv.pop(1), run_name="__main__")
finally:
    heavy = {"torch", "tensordict", "torchrl", "hydra", "omegaconf", "numba"} & set(sys.modules)
    assert not heavy, heavy
"""


@pytest.fixture
def report(request: pytest.FixtureRequest) -> Callable[..., subprocess.CompletedProcess[str]]:
    """``python -W error scripts/report.py *args``; fails if that imports torch, Hydra or numba."""
    script = request.config.rootpath / "scripts" / "report.py"

    def run(*args: Path | str) -> subprocess.CompletedProcess[str]:
        program = [sys.executable, "-W", "error", "-c", WITHOUT_TORCH, str(script)]
        command = [*program, *map(str, args)]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    return run


def damage_truncated(job: Path) -> None:
    text = (job / "trials.csv").read_text()
    (job / "trials.csv").write_text(text[: len(text) - 30])


def damage_foreign(job: Path) -> None:
    (job / "trials.csv").write_text("a,b\n1,2\n")


def damage_binary(job: Path) -> None:
    (job / "trials.csv").write_bytes(bytes(range(256)))


def damage_lost_row(job: Path) -> None:
    lines = (job / "trials.csv").read_text().splitlines()
    (job / "trials.csv").write_text("\n".join(lines[:-1]) + "\n")


def damage_contradiction(job: Path) -> None:
    text = (job / "trials.csv").read_text()
    (job / "trials.csv").write_text(text.replace("0.5,converged", "0.5,diverged", 1))


def damage_unfinished_trial(job: Path) -> None:
    text = (job / "trials.csv").read_text()
    (job / "trials.csv").write_text(text.replace("1000,False", "700,False"))


def damage_twice(job: Path) -> None:
    text = (job / "trials.csv").read_text()
    (job / "trials.csv").write_text(text.replace("\n1,0,", "\n0,0,"))


def damage_run(job: Path) -> None:
    (job / "run.json").write_text('{"config": {')


def damage_config(job: Path) -> None:
    run = json.loads((job / "run.json").read_text())
    (job / "run.json").write_text(json.dumps(run | {"config": {}}))


DAMAGES = [value for name, value in sorted(globals().items()) if name.startswith("damage_")]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda d: d.__name__.removeprefix("damage_"))
def test_a_damaged_job_alone_is_one_line_that_names_it(tmp_path, make_job, damage):
    job = make_job(tmp_path, "softmax", [150, 200, 1000])
    damage(job)
    with pytest.raises(ResultsError) as error:
        load([tmp_path])
    assert "\n" not in str(error.value)
    assert str(job) in str(error.value)


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda d: d.__name__.removeprefix("damage_"))
def test_a_damaged_job_beside_others_is_a_gap(tmp_path, make_job, damage):
    sweep = tmp_path / "train"
    make_job(sweep, "good", [150, 200, 1000], strategy="argmax")
    damage(make_job(sweep, "bad", [150, 200, 1000]))
    loaded = load([tmp_path])
    assert [job.folder.name for job in loaded.jobs] == ["good"]
    (gap,) = loaded.gaps
    assert gap.what == "train/bad"
    assert str(tmp_path) not in gap.why


def test_a_gap_is_marked_in_the_page_and_told_on_stderr(tmp_path, make_job, report):
    make_job(tmp_path / "train", "good", [150, 200, 1000])
    damage_foreign(make_job(tmp_path / "train", "bad", [150, 200]))
    running = make_job(tmp_path / "train", "running", [150, 200])
    (running / "run.json").unlink()
    done = report(tmp_path, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    warnings = [line for line in done.stderr.splitlines() if line.startswith("warning: ")]
    assert len(warnings) == 2
    assert "train/bad" in done.stderr
    page = (tmp_path / "out" / "index.html").read_text()
    marked = page[page.index('id="gaps"') : page.index('id="answer"')]
    assert "train/bad" in marked
    assert "train/running" in marked
    assert UNFINISHED in marked


def test_nothing_to_report_is_one_line_and_status_1(tmp_path, make_job, run_many, request):
    folders = {what: tmp_path / what for what in ("empty", "absent", "foreign", "running", "file")}
    damage_foreign(make_job(folders["foreign"], "softmax", [150]))
    (make_job(folders["running"], "softmax", [150]) / "run.json").unlink()
    folders["empty"].mkdir()
    folders["file"].write_text("")
    script = request.config.rootpath / "scripts" / "report.py"
    commands = [[str(folder)] for folder in folders.values()]
    for folder, done in zip(folders.values(), run_many(commands, tmp_path, script), strict=True):
        assert done.returncode == 1
        assert done.stdout == ""
        assert len(done.stderr.splitlines()) == 1
        assert str(folder) in done.stderr
        assert not (folder / "report").exists()


def test_the_same_job_given_twice_counts_once(tmp_path, make_job):
    make_job(tmp_path / "train", "softmax", [150, 200])
    assert len(load([tmp_path, tmp_path / "train"]).jobs) == 1


def test_a_foreign_timings_file_is_a_gap(tmp_path, make_job):
    make_job(tmp_path / "train", "softmax", [150, 200])
    (tmp_path / "train" / "timings.csv").write_text("experiment,job\ntrain,softmax\n")
    loaded = load([tmp_path])
    assert loaded.gaps[0].what == "train/timings.csv"
    assert loaded.jobs[0].timing is None


def test_timings_of_a_job_are_those_of_its_trials(tmp_path, make_job):
    make_job(tmp_path / "train", "softmax", [150, 200])
    (tmp_path / "train" / "timings.csv").write_text(
        "experiment,job,trial,seconds,frames\n"
        "train,softmax,1,0.25,9\ntrain,softmax,0,0.5,9\ntrain,softmax,7,9.0,9\n"
        "other,softmax,0,9.0,9\n"
    )
    timing = load([tmp_path]).jobs[0].timing
    assert timing is not None
    assert (timing.trial.tolist(), timing.seconds.tolist()) == ([0, 1], [0.5, 0.25])


def test_what_was_typed_is_read_back(tmp_path, make_job):
    job = make_job(tmp_path, "softmax", [150])
    (job / ".hydra" / "overrides.yaml").write_text("- strategy=softmax\n- 'a=[1,''x'']'\n")
    assert load([tmp_path]).jobs[0].command == ("strategy=softmax", "a=[1,'x']")


def test_episodes_cut_off_leave_a_gap_and_no_false_curve(tmp_path, make_job):
    job = make_job(tmp_path / "train", "softmax", [150, 200])
    lines = (job / "episodes.csv").read_text().splitlines()
    (job / "episodes.csv").write_text("\n".join(lines[:-3]) + "\n")
    page, gaps = build_report([tmp_path], tmp_path / "out")
    assert re.search(r"train/softmax/episodes\.csv.*trials\.csv", gaps[0].why)
    assert not list((tmp_path / "out" / "figures").glob("*learning*"))
    assert "learning curves (not recorded)" in page.read_text()


def test_figures_of_others_in_the_folder_for_the_report_are_kept(tmp_path, make_job):
    make_job(tmp_path / "train", "softmax", [150, 200])
    kept = tmp_path / "out" / "figures" / "mine.png"
    kept.parent.mkdir(parents=True)
    kept.write_bytes(b"x")
    build_report([tmp_path], tmp_path / "out")
    assert kept.exists()
