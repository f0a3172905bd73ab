"""Diagnostics and evaluations are read back, and held against what they must be."""

import json
import shutil
import tracemalloc

import numpy as np
import pytest

from trl_explore.jobs.files import ResultsError
from trl_explore.jobs.reading import read_job
from trl_explore.jobs.records import read_diagnostics, read_episodes, read_evaluations
from trl_explore.training.diagnostic_quantities import DIAGNOSTIC_COLUMNS
from trl_explore.training.diagnostics import COLUMNS


@pytest.fixture(scope="module")
def recorded(run_many, tmp_path_factory):
    place = tmp_path_factory.mktemp("recorded")
    words = (
        "strategy=epsilon_greedy trials=3 max_iterations=7 episodes_per_update=2 evaluate_every=3"
        " evaluate_episodes=2 diagnostics=true output_dir=."
    )
    (ran,) = run_many([words.split()], place)
    assert ran.returncode == 0, ran
    (run,) = place.glob("**/run.json")
    return run.parent


@pytest.fixture
def job(recorded, tmp_path):
    """A copy without the digests of its files, which tests may change."""
    shutil.copytree(recorded, tmp_path / "job")
    run = json.loads((tmp_path / "job" / "run.json").read_text())
    (tmp_path / "job" / "run.json").write_text(json.dumps({**run, "files": {}}))
    return tmp_path / "job"


def edit(path, change):
    lines = path.read_text().splitlines()
    path.write_text("\n".join(change(lines)) + "\n")


def test_one_row_per_trial_and_iteration(recorded):
    rows = read_diagnostics(recorded)
    assert rows is not None
    assert list(rows.columns) == ["trial", "iteration", *COLUMNS]
    assert rows["trial"].tolist() == [0] * 7 + [1] * 7 + [2] * 7
    assert rows["iteration"].tolist() == list(range(1, 8)) * 3
    assert DIAGNOSTIC_COLUMNS == COLUMNS
    again = read_diagnostics(recorded, read_episodes(recorded))
    assert again is not None
    assert again.equals(rows)


def test_evaluations_are_those_of_the_configuration(recorded):
    columns = read_evaluations(recorded)
    assert columns is not None
    pairs = sorted(zip(columns["trial"].tolist(), columns["iteration"].tolist(), strict=True))
    assert pairs == [(t, i) for t in range(3) for i in (0, 0, 3, 3, 6, 6, 7, 7)]
    assert np.isfinite(columns["score"]).all()
    final = read_evaluations(recorded, "final")
    assert final is not None
    assert (final["iteration"] == 7).all()
    assert final["trial"].tolist() == [0] * 20 + [1] * 20 + [2] * 20
    outcomes = read_job(recorded)
    assert outcomes.learned_score is not None
    means = final["score"].reshape(3, 20).mean(1)
    np.testing.assert_allclose(outcomes.learned_score, means)
    confirmation = read_evaluations(recorded, "confirmation")
    assert confirmation is not None
    assert len(confirmation["trial"]) == 0


def test_evaluations_of_older_versions_are_read(job):
    """They had one purpose, and none at iteration 0 or at the cap."""
    lines = ["trial,iteration,score"]
    lines += [f"{t},{i},{10 * i + k}" for i in (3, 6) for t in range(3) for k in range(2)]
    edit(job / "evaluations.csv", lambda _: lines)
    columns = read_evaluations(job)
    assert columns is not None
    assert len(columns["trial"]) == 12
    assert columns["score"].max() == 61
    edit(job / "evaluations.csv", lambda _: lines[:-1])
    with pytest.raises(ResultsError, match=r"evaluations\.csv.*trials\.csv"):
        read_evaluations(job)


def test_what_was_not_recorded_is_none(job):
    (job / "evaluations.csv").unlink()
    edit(job / "episodes.csv", lambda lines: [",".join(x.split(",")[:4]) for x in lines])
    assert read_evaluations(job) is None
    assert read_diagnostics(job) is None


def column(name, value, line=1):
    place = ["trial", "iteration", "score", "frames", *COLUMNS].index(name)

    def change(lines):
        fields = lines[line].split(",")
        fields[place] = value
        return [*lines[:line], ",".join(fields), *lines[line + 1 :]]

    return change


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (column("kl", "x"), "kl"),
        (column("greedy_share", "1.5"), "greedy_share.*0.*1"),
        (column("gradient_norm", "-1"), "gradient_norm.*0.*inf"),
        (column("kl", "0.123456"), "iteration"),
        (lambda lines: [x.rsplit(",", 1)[0] for x in lines], "gradient_norm"),
    ],
    ids=["text", "share", "negative", "differing", "missing"],
)
def test_damaged_diagnostics_are_refused(job, change, complaint):
    edit(job / "episodes.csv", change)
    with pytest.raises(ResultsError, match=complaint) as caught:
        read_diagnostics(job)
    assert "\n" not in str(caught.value)


def test_no_value_is_allowed(job):
    def change(lines):
        fields = [line.split(",") for line in lines]
        place = fields[0].index("kl")
        return [",".join([*f[:place], "nan" if k else f[place], *f[place + 1 :]])
                for k, f in enumerate(fields)]  # fmt: skip

    edit(job / "episodes.csv", change)
    rows = read_diagnostics(job)
    assert rows is not None
    assert rows["kl"].isna().all()


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda lines: lines[:-1], r"evaluations\.csv.*trials\.csv"),
        (lambda lines: [*lines, "9,3,1.0,scheduled"], r"evaluations\.csv.*trials\.csv"),
        (lambda lines: [*lines, "1,8,1.0,confirmation"], r"evaluations\.csv.*trials\.csv"),
        (lambda lines: [*lines, "1,3,1.0,pleasure"], r"evaluations\.csv.*purpose.*'pleasure'"),
        (lambda lines: [lines[0], "0,3,nan,scheduled", *lines[2:]], r"evaluations\.csv.*finite"),
        (lambda lines: ["trial,iteration", *lines[1:]], r"evaluations\.csv.*4.*2"),
    ],
    ids=["short", "foreign", "late", "purpose", "nan", "column"],
)
def test_damaged_evaluations_are_refused(job, change, complaint):
    edit(job / "evaluations.csv", change)
    with pytest.raises(ResultsError, match=complaint):
        read_evaluations(job)


@pytest.mark.parametrize(
    ("key", "value"), [("evaluate_episodes", 10**6), ("evaluate_every", 10**40)]
)
def test_a_damaged_number_of_evaluations_takes_no_memory(job, key, value):
    run = json.loads((job / "run.json").read_text())
    run["config"][key] = value
    (job / "run.json").write_text(json.dumps(run))
    tracemalloc.start()
    with pytest.raises(ResultsError, match=r"evaluations\.csv"):
        read_evaluations(job)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 10**7


def test_evaluations_that_nobody_asked_for_are_refused(job):
    run = json.loads((job / "run.json").read_text())
    run["config"]["evaluate_every"] = 0
    (job / "run.json").write_text(json.dumps(run))
    with pytest.raises(ResultsError, match=r"evaluations\.csv"):
        read_evaluations(job)
