"""Files that are damaged, foreign or of an older version: one line, or what they hold."""

from __future__ import annotations

import json
import shutil

import pytest

from tests.jobs.written import EPISODES_CSV, TRIALS_CSV
from trl_explore import jobs as results
from trl_explore.jobs.files import ResultsError


def one_line(error: pytest.ExceptionInfo) -> str:
    text = str(error.value)
    assert text
    assert "\n" not in text
    return text


@pytest.mark.parametrize(
    "text",
    [
        "",
        "nonsense\n",
        "\x00\x01\x02",
        "a,b,c\n1,2,3\n",
        TRIALS_CSV.replace("status", "state"),
        TRIALS_CSV[:-3],  # "cap"
        TRIALS_CSV[:-18],  # within the seconds
        TRIALS_CSV[: TRIALS_CSV.rindex("126") + 2],  # within the frames
        TRIALS_CSV.replace("33,1.5", ",1.5"),
        TRIALS_CSV.replace("10,5,3", "10,5,3.5"),
        TRIALS_CSV.replace("10,5,3", "ten,5,3"),
        TRIALS_CSV.replace("True", "perhaps"),
        TRIALS_CSV.replace("2.5", "much"),
        TRIALS_CSV.replace("capped", "stopped"),
        TRIALS_CSV + "13,5,4,False,4.0,126,2.000000,capped,1,2,3\n",
        TRIALS_CSV.split("12,5")[0],  # a trial is missing
        TRIALS_CSV + "13,5,4,False,4.0,126,2.000000,capped\n",  # one too many
    ],
)
def test_a_truncated_or_foreign_table_of_trials(job, text):
    (job / "trials.csv").write_text(text)
    with pytest.raises(ResultsError) as error:
        results.read_job(job)
    assert "trials.csv" in one_line(error)


def test_a_table_of_trials_that_is_no_text(job):
    (job / "trials.csv").write_bytes(b"\xff\xfe\x9d\x00" * 9)
    with pytest.raises(ResultsError) as error:
        results.read_job(job)
    assert "trials.csv" in one_line(error)


@pytest.mark.parametrize(
    "text", ["", "trial,iteration\n1,2\n", EPISODES_CSV[:-6], "\x00", EPISODES_CSV + "1,2,3,4,5\n"]
)
def test_truncated_or_foreign_episodes(job, text):
    (job / "episodes.csv").write_text(text)
    with pytest.raises(ResultsError) as error:
        results.read_episodes(job)
    assert "episodes.csv" in one_line(error)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"status": "finished"}', "null", "\x00"])
def test_a_broken_record(job, text):
    (job / "run.json").write_text(text)
    for read in (results.read_run, results.read_job):
        with pytest.raises(ResultsError) as error:
            read(job)
        assert "run.json" in one_line(error)


@pytest.mark.parametrize(("key", "value"), [("seed", 6), ("trials", 4)])
def test_a_record_of_other_trials(job, key, value):
    run = json.loads((job / "run.json").read_text())
    (job / "run.json").write_text(json.dumps({**run, key: value}))
    with pytest.raises(
        ResultsError, match=r"trials\.csv.*(another seed than 6|expected 4)"
    ) as error:
        results.read_job(job)
    one_line(error)


@pytest.mark.parametrize("name", ["trials.csv", "run.json"])
def test_a_missing_file(job, name):
    (job / name).unlink()
    with pytest.raises(ResultsError, match=f"{name}.*missing"):
        results.read_job(job)


def test_missing_curves(job):
    shutil.rmtree(job / "scalars")
    with pytest.raises(ResultsError, match="scalars") as error:
        results.read_curves(job)
    one_line(error)


def test_an_empty_folder(tmp_path):
    assert results.find_jobs(tmp_path) == []
    assert results.read_jobs([tmp_path]) == []
    assert results.read_frame([tmp_path]).empty
    with pytest.raises(ResultsError):
        results.read_job(tmp_path)


@pytest.mark.parametrize("cut", ["row", "number"])
def test_truncated_episodes_are_noticed(job, cut):
    path = job / "episodes.csv"
    assert len(results.read_episodes(job))
    text = path.read_text()
    shorter = text[: text.rstrip("\n").rindex("\n") + 1] if cut == "row" else text[:-2] + "\n"
    path.write_text(shorter)
    with pytest.raises(results.ResultsError, match=r"episodes\.csv"):
        results.read_episodes(job)


def test_damaged_curves_are_one_line(job):
    path = job / "scalars" / "score.csv"
    path.write_text(path.read_text().replace("\n", "\nx,", 1))
    with pytest.raises(results.ResultsError, match="scalars"):
        results.read_curves(job)


@pytest.mark.parametrize("key", ["versions", "machine"])
def test_an_incomplete_record_is_one_line(job, key):
    run = json.loads((job / "run.json").read_text())
    del run[key]
    (job / "run.json").write_text(json.dumps(run))
    with pytest.raises(results.ResultsError, match=key):
        results.read_job(job)


OLD = "\n".join(",".join(line.split(",")[:8]) for line in TRIALS_CSV.splitlines()) + "\n"


def test_files_without_the_columns_of_the_measures_are_read(job):
    """Files of an older version: a trial stopped when it passed."""
    (job / "trials.csv").write_text(OLD)
    (job / "run.json").write_text(json.dumps({**results.read_run(job), "files": {}}))
    outcomes = results.read_job(job)
    assert outcomes.passed is outcomes.converged
    assert outcomes.iterations_to_pass is outcomes.iterations
    assert outcomes.learned is None


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        (",True,2,41", ",True,3,41", "iterations_to_pass contradicts passed or iterations"),
        (",False,3,33", ",False,2,33", "iterations_to_pass contradicts"),
        (",True,2,41", ",True,2,42", "frames_to_pass contradicts passed or frames"),
        (",True,2,41", ",maybe,2,41", "column passed holds 'maybe'"),
        (",iterations_to_pass", ",other", "missing column: iterations_to_pass"),
        ("\n12,", "\n13,", "the trials are not consecutive"),
        (",frames_to_pass\n", ",frames_to_pass,score\n", "duplicate column score"),
    ],
)
def test_measures_that_contradict_the_trials_are_refused(job, old, new, complaint):
    path = job / "trials.csv"
    header, *rows = path.read_text().replace(old, new).splitlines()
    more = "," * (header.count(",") - rows[0].count(","))
    path.write_text("\n".join([header, *(row + more for row in rows), ""]))
    with pytest.raises(ResultsError, match=complaint):
        results.read_trials(job)


ABSURD = {
    "trials": [0, -1, 2.5, "3"],
    "seconds": [-1, float("inf"), float("nan"), "x", None],
    "seed": [-1, 10**30],
    "config.score_window": [0, -3, "x", 10**30, None, 2.5, True],
    "config.max_iterations": [0, -5, "many", 10**30, 1e400],
    "config.score_threshold": ["x", float("nan"), float("inf"), None],
    "config.episodes_per_update": [0, "x", 10**30],
    "config.evaluate_episodes": [0, 10**9, "x"],
    "config.first_trial": [-1, "x"],
}


@pytest.mark.parametrize("key", ABSURD)
def test_absurd_values_in_a_record_are_one_line(job, key):
    path, text = job / "run.json", (job / "run.json").read_text()
    for value in ABSURD[key]:
        run = json.loads(text)
        *within, name = key.split(".")
        (run["config"] if within else run)[name] = value
        path.write_text(json.dumps(run))
        with pytest.raises(ResultsError, match=rf"run\.json: .*{name} is") as error:
            results.read_job(job)
        one_line(error)
