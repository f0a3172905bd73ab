"""``scripts/train.py`` as a user meets it."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from safetensors.numpy import load_file

from tests.commands.trained import (
    NAMES,
    RESULTS,
    SCRIPT,
    STRATEGIES,
    complaints,
    names,
    results_below,
)
from trl_explore.commands.job import check_same
from trl_explore.config import ConfigError
from trl_explore.jobs import versions
from trl_explore.jobs.columns import (
    EPISODE_COLUMNS,
    LEARN_COLUMNS,
    PASS_COLUMNS,
    TRIAL_COLUMNS,
)
from trl_explore.jobs.reading import read_frame, read_jobs


def snapshot(folder: Path) -> dict[str, tuple[bytes, int]]:
    """Every file below a folder: contents and time of its last change.

    Without ``multirun.yaml``, which Hydra writes beside the jobs whenever a sweep is launched.
    """
    return {
        str(path.relative_to(folder)): (path.read_bytes(), path.stat().st_mtime_ns)
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "multirun.yaml"
    }


def payload(job: Path) -> dict[str, str]:
    """What a job's files say, apart from wall times: seconds, run.json and Hydra's own."""
    files = {
        str(path.relative_to(job)): path.read_bytes().hex()
        for path in sorted(job.rglob("*"))
        if path.is_file() and path.name != "run.json" and ".hydra" not in path.parts
    }
    table = pd.read_csv(job / "trials.csv", dtype=str).drop(columns="seconds")
    return {**files, "trials.csv": table.to_csv()}


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("cli")


@pytest.fixture(scope="module")
def sweep(place, run_cli):
    """A real multirun from a folder of the user's; what it printed."""
    return run_cli(
        "-m", "experiment=debug", f"strategy={','.join(STRATEGIES)}", "score_threshold=40",
        cwd=place,
    )  # fmt: skip


@pytest.fixture(scope="module")
def folder(place, sweep) -> Path:
    assert sweep.returncode == 0, sweep.stderr
    return place / "outputs" / "debug"


def job_of(folder: Path, strategy: str) -> Path:
    return folder / f"{NAMES[strategy]},score_threshold=40.0"


# A sweep


def test_a_sweep_prints_one_table_and_the_place(sweep, folder):
    header, _, *rows, place = sweep.stdout.splitlines()[-8:]
    assert header.startswith("job")
    assert [row.split()[0] for row in rows] == [job_of(folder, s).name for s in STRATEGIES]
    assert [row.split()[1] for row in rows] == ["3"] * 5
    assert place.startswith("results: ")
    shown = Path(place.removeprefix("results: "))
    assert folder.parent.parent.joinpath(shown).samefile(folder)


def test_a_sweep_is_quiet_without_a_terminal(sweep):
    assert complaints(sweep) == []
    assert set("\r\033").isdisjoint(sweep.stdout + sweep.stderr)


def test_a_sweep_leaves_one_folder_for_each_job(folder):
    jobs = {job_of(folder, strategy).name for strategy in STRATEGIES}
    assert {path.name for path in folder.iterdir() if path.is_dir()} == jobs
    for strategy in STRATEGIES:
        job = job_of(folder, strategy)
        assert names(job) == RESULTS | {".hydra"}
        assert names(job / ".hydra") == {"config.yaml", "hydra.yaml", "overrides.yaml"}
        run = json.loads((job / "run.json").read_text())
        assert run["status"] == "finished"
        assert (run["experiment"], run["strategy"]) == ("debug", strategy)
        assert run["config"]["score_threshold"] == 40
        assert f"strategy={strategy}" in (job / ".hydra" / "overrides.yaml").read_text()


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_the_files_of_a_job_agree_with_each_other(folder, strategy):
    job = job_of(folder, strategy)
    trials = pd.read_csv(job / "trials.csv")
    episodes = pd.read_csv(job / "episodes.csv")
    assert tuple(trials) == (*TRIAL_COLUMNS, *PASS_COLUMNS, *LEARN_COLUMNS)
    assert tuple(episodes) == tuple(EPISODE_COLUMNS)
    assert trials["trial"].tolist() == [0, 1, 2]
    assert (trials["seed"] == 0).all()
    assert trials["seconds"].between(0, 60, inclusive="neither").all()
    order = episodes.sort_values(["iteration", "trial"], kind="stable")
    assert order.index.tolist() == episodes.index.tolist()
    for row in trials.itertuples():
        mine = episodes[episodes["trial"] == row.trial]
        assert mine["iteration"].tolist() == list(range(1, row.iterations + 1))
        assert (mine["score"] == mine["frames"]).all()  # CartPole pays 1 for each frame
        assert mine["frames"].sum() == row.frames
        means = mine["score"].rolling(10).mean()
        assert row.score == pytest.approx(mine["score"].tail(10).mean(), abs=1e-9)
        passed = (means > 40).to_numpy()
        assert row.converged == passed[-1]
        assert not passed[:-1].any()
        assert row.status == ("converged" if row.converged else "capped")
        assert row.iterations == 20 or row.converged
    iterations = trials["iterations"].max()
    for curve in ("episode_score", "score", "active", "converged"):
        lines = (job / "scalars" / f"{curve}.csv").read_text().splitlines()
        assert [int(line.split(",")[0]) for line in lines] == list(range(1, iterations + 1))
    first = episodes[episodes["iteration"] == 1]["score"].mean()
    text = (job / "scalars" / "episode_score.csv").read_text().splitlines()[0]
    assert float(text.split(",")[1]) == pytest.approx(first)
    (weight,) = load_file(job / "weights.safetensors").values()
    assert weight.shape == (3, 2, 4)
    assert np.isfinite(weight).all()


def test_a_sweep_reads_back_as_one_frame(folder):
    frame = read_frame([folder])
    assert len(frame) == 15
    assert set(frame["strategy"]) == set(STRATEGIES)
    assert len(read_jobs([folder.parent])) == 5


# Again, otherwise


@pytest.fixture(scope="module")
def others(place, folder, run_many):
    """The same trials in other jobs: another order, alone, with other threads and collectors."""
    debug = ["experiment=debug", "score_threshold=40"]
    some = ["decaying_epsilon_greedy", "softmax"]
    commands = [
        ["-m", *debug, f"strategy={','.join(reversed(STRATEGIES))}", "output_dir=reversed"],
        *(
            [*debug, f"strategy={strategy}", f"first_trial={trial}", "trials=1", "output_dir=alone"]
            for strategy in some
            for trial in (0, 2)
        ),
        [*debug, "threads=2", "output_dir=threads"],
        [*debug, "collector=torchrl", "output_dir=torchrl"],
        [*debug, "episodes=false", "output_dir=silent"],
    ]
    ran = run_many(commands, cwd=place)
    assert [(process.returncode, complaints(process)) for process in ran] == [(0, [])] * len(
        commands
    )
    return place


def test_the_order_of_jobs_does_not_matter(folder, others):
    for strategy in STRATEGIES:
        job, other = job_of(folder, strategy), job_of(others / "reversed" / "debug", strategy)
        assert payload(other) == payload(job)
        runs = [json.loads((path / "run.json").read_text()) for path in (job, other)]
        for run in runs:
            del run["seconds"], run["config"]["output_dir"]
            del run["files"]["trials.csv"]["sha256"]  # it has a column of seconds
        assert runs[0] == runs[1]


@pytest.mark.parametrize("strategy", ["decaying_epsilon_greedy", "softmax"])
@pytest.mark.parametrize("trial", [0, 2])
def test_a_trial_alone_is_the_trial_of_the_batch(folder, others, strategy, trial):
    suffix = (
        f"{NAMES[strategy]}," + (f"first_trial={trial}," if trial else "") + "score_threshold=40.0"
    )
    alone, batch = others / "alone" / "debug" / f"{suffix},trials=1", job_of(folder, strategy)
    for name, drop in (("trials.csv", ["seconds"]), ("episodes.csv", [])):
        one, many = (
            pd.read_csv(job / name, dtype=str).drop(columns=drop) for job in (alone, batch)
        )
        many = many[many["trial"] == str(trial)].reset_index(drop=True)
        pd.testing.assert_frame_equal(one, many)
    one, many = (load_file(job / "weights.safetensors") for job in (alone, batch))
    for name, weight in one.items():
        np.testing.assert_array_equal(weight[0], many[name][trial])


def test_threads_do_not_matter(folder, others):
    (job,) = (others / "threads" / "debug").iterdir()
    assert job.name == job_of(folder, "softmax").name
    assert payload(job) == payload(job_of(folder, "softmax"))


def test_collectors_give_the_same_episodes(folder, others):
    (job,) = (others / "torchrl" / "debug").iterdir()
    assert "collector=torchrl" in job.name.split(",")
    assert json.loads((job / "run.json").read_text())["collector"] == "TorchRLCollector"
    name = "episodes.csv"
    assert (job / name).read_bytes() == (job_of(folder, "softmax") / name).read_bytes()


def test_episodes_can_be_switched_off(folder, others):
    (job,) = (others / "silent" / "debug").iterdir()
    expected = payload(job_of(folder, "softmax"))
    del expected["episodes.csv"]
    assert payload(job) == expected


# Again, the same


def test_a_finished_folder_is_left_alone(place, folder, run_many):
    before = snapshot(place)
    debug = ["experiment=debug", "score_threshold=40"]
    job = job_of(folder, "softmax")
    ran = run_many(
        [
            ["-m", *debug, f"strategy={','.join(STRATEGIES)}"],
            debug,
            [*debug, "score_threshold=40.0", "strategy.temperature=1"],
            [*debug, f"hydra.run.dir='{job}'", "seed=1", "strategy.temperature=2"],
        ],
        cwd=place,
    )
    again, single, spelt, foreign = ran
    for process in (again, single, spelt):
        assert (process.returncode, complaints(process)) == (0, [])
    assert again.stdout.count("restart=true") == 5
    assert [line.split()[0] for line in again.stdout.splitlines()[-6:-1]] == [
        job_of(folder, strategy).name for strategy in STRATEGIES
    ]
    for process in (single, spelt):
        assert re.search(rf"{re.escape(job.name)}: .*restart=true", process.stdout)
        assert "results: " in process.stdout
    assert foreign.returncode == 1
    (line,) = complaints(foreign)
    assert "configuration" in line
    assert re.search(r"seed: 0\b.*\b1\b.*strategy\.temperature: 1\.0\b.*\b2\b", line)
    assert "restart=true" in line
    assert snapshot(place) == before


def test_restart_starts_over(folder, run_many, tmp_path):
    shutil.copytree(folder, tmp_path / "outputs" / "debug")
    job = job_of(tmp_path / "outputs" / "debug", "softmax")
    before, finished = payload(job), snapshot(job)
    (job / "episodes.csv").write_text("spoilt")
    (job / "scalars" / "old.csv").write_text("1,2\n")
    same, other = run_many(
        [
            ["experiment=debug", "score_threshold=40", "restart=true"],
            ["experiment=debug", f"hydra.run.dir='{job}'", "seed=1", "restart=true"],
        ],
        cwd=tmp_path,
    )
    assert (same.returncode, complaints(same)) == (0, [])
    assert "restart=true" not in same.stdout
    assert (other.returncode, complaints(other)) == (0, [])
    assert (pd.read_csv(job / "trials.csv")["seed"] == 1).all()
    assert snapshot(job).keys() == finished.keys()
    assert payload(job) != before


def test_restart_gives_the_same_results(folder, run_many, tmp_path):
    job = job_of(tmp_path / "debug", "argmax")
    shutil.copytree(job_of(folder, "argmax"), job)
    before = snapshot(job)
    (job / "trials.csv").write_text("spoilt")
    (ran,) = run_many(
        [
            [
                "experiment=debug", "score_threshold=40", "strategy=argmax",
                f"output_dir={tmp_path}", "restart=true",
            ]
        ],
        cwd=tmp_path,
    )  # fmt: skip
    assert (ran.returncode, complaints(ran)) == (0, [])
    assert payload(job) == payload(job_of(folder, "argmax"))
    after = snapshot(job)
    assert after.keys() == before.keys()
    assert all(after[name][1] > before[name][1] for name in after)


def test_an_unfinished_job_is_run(folder, run_many, tmp_path):
    """What an interrupted job left behind neither counts nor stays."""
    job = job_of(tmp_path / "debug", "softmax")
    shutil.copytree(job_of(folder, "softmax"), job)
    (job / "run.json").unlink()
    (job / "trials.csv").write_text("trial,seed\n")
    (ran,) = run_many(
        [["experiment=debug", "score_threshold=40", f"output_dir={tmp_path}"]], tmp_path
    )
    assert (ran.returncode, complaints(ran)) == (0, [])
    assert "restart=true" not in ran.stdout
    assert payload(job) == payload(job_of(folder, "softmax"))


def test_a_damaged_record_is_one_line(folder, run_many, tmp_path):
    job = job_of(tmp_path / "debug", "softmax")
    shutil.copytree(job_of(folder, "softmax"), job)
    (job / "run.json").write_text("{")
    before = snapshot(job)
    (ran,) = run_many(
        [["experiment=debug", "score_threshold=40", f"output_dir={tmp_path}"]], tmp_path
    )
    assert ran.returncode == 1
    (line,) = complaints(ran)
    assert "run.json" in line
    assert snapshot(job) == before


def test_an_interrupted_job_leaves_no_results(tmp_path):
    command = [
        "experiment=debug", "strategy=random", "max_iterations=1000000", "score_threshold=1e9",
        "collector=torchrl", f"output_dir={tmp_path}",
    ]  # fmt: skip
    with subprocess.Popen(
        [sys.executable, str(SCRIPT), *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        deadline = time.monotonic() + 60
        while not list(tmp_path.glob("*/*/.hydra/overrides.yaml")):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    (line,) = stderr.splitlines()
    assert line.startswith("interrupted")
    assert not results_below(tmp_path)


def test_a_finished_job_outlives_a_change_of_the_program(tmp_path):
    values = {"seed": 0}
    record = {"config": values, "versions": versions(), "code": {"trl_explore": "before"}}
    check_same(tmp_path, record, values, finished=True)
    with pytest.raises(ConfigError, match="code of trl_explore has changed"):
        check_same(tmp_path, record, values, finished=False)
