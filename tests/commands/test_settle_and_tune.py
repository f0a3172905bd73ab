"""``settle`` and ``tune`` as a user runs them, with jobs of a few iterations, in one process."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys

import pytest

from trl_explore.commands.settle import _Jobs
from trl_explore.config import ConfigError

PROGRAM = """
import os
from trl_explore.commands.main import main
for words in {calls}:
    os.environ.pop("HYDRA_FULL_ERROR", None)  # else the second call shows tracebacks
    print("status", main(words), flush=True)
"""
SWEEP = [
    "strategy=softmax,random", "max_iterations=30", "score_window=5", "score_threshold=25",
    "evaluate_every=0", "episodes=false",
]  # fmt: skip
TUNE = [
    "train", "experiment=tuned", "trials=2", "--judge", "6", "--lr", "0.01,0.1",
    "strategy=argmax,epsilon_greedy",
    "strategy.epsilon=0.2,0.4", "max_iterations=6", "score_window=3", "score_threshold=15",
    "evaluate_every=0",
]  # fmt: skip


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """The folder, what each call printed, and the errors."""
    folder = tmp_path_factory.mktemp("settle")
    sweep = [*SWEEP, f"output_dir={folder}"]
    study = folder / "study.yaml"
    study.write_text(f"configurations: [{{sweep: [{', '.join(map(repr, SWEEP))}]}}]\n"
                     "until: settled\nbudget: 20\nmeasures: [score]\nlevel: 0.9\n")  # fmt: skip
    calls = [
        ["settle", "--first", "6", "--most", "9", *sweep],
        ["train", "-m", *sweep, "until=settled", "trials=6", "budget=9"],
        ["settle", "--first", "6", "--most", "12", *sweep],
        ["settle", *sweep, "trials=3"],
        ["settle", "strategy=softmax", "max_iterations=2", f"output_dir={folder / 'one'}"],
        [*TUNE, f"output_dir={folder / 'tuned'}"],
        [*TUNE, f"output_dir={folder / 'tuned'}", "optimizer.lr=1"],
        ["tune", "strategy=none", f"output_dir={folder / 'tuned'}"],
        ["train", *sweep, "until=soon"],
        ["report", f"{study}"],
    ]
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROGRAM.format(calls=calls)],
        capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip
    statuses = [line for line in run.stdout.splitlines() if line.startswith("status")]
    assert statuses == [f"status {n}" for n in (0, 0, 1, 1, 1, 0, 1, 1, 1, 0)], run.stderr
    errors = [line for line in run.stderr.splitlines() if line.startswith("error: ")]
    return folder, run.stdout.split("status "), errors


def test_settle_adds_trials_and_continues(ran):
    folder, shown, _ = ran
    with (folder / "train" / "settle.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["first"], row["second"]) == ("softmax,temperature=1.0", "random")
    assert row["greater mean"] in ("open", row["first"], row["second"])
    assert row["greater mean"] != "open" or row["trials"] == "9"
    # The command that is repeated runs nothing and says the same.
    first, again = ([x for x in text.splitlines() if "of at most" in x] for text in shown[:2])
    assert first == again != []
    jobs = {path.name for path in (folder / "train").iterdir() if path.is_dir()}
    assert any("first_trial=6" in name for name in jobs)


def test_tune_judges_the_best_setting_on_another_seed(ran):
    folder, shown, _ = ran
    page = (folder / "tuned" / "report" / "index.html").read_text()
    assert "is the best of 2 settings" in shown[5]
    assert "is the best of 4 settings" in shown[5]
    tuned = {path.name for path in (folder / "tuned" / "tuning" / "train").iterdir()}
    assert sum("epsilon_greedy" in name for name in tuned) == 4
    judged = [p.name for p in (folder / "tuned" / "judging" / "train").iterdir() if p.is_dir()]
    assert len(judged) == 2
    assert all("seed=1" in name for name in judged)
    assert "each tuned" in page


def test_a_study_runs_its_sweeps_until_they_are_settled(ran):
    folder, *_ = ran
    plan = json.loads((folder / "study" / "runs" / "train" / "settle.json").read_text())
    assert (plan["looks"], plan["measure"], plan["level"]) == ([20], "score", 0.9)
    page = (folder / "study" / "report" / "index.html").read_text()
    assert "Trials were added until the comparisons were decided (until=settled)" in page
    assert "(all in train/settle.csv)" in page


def test_errors_are_one_line(ran):
    *_, errors = ran
    expected = [
        "settle.json plans looks=[6, 9], not [6, 9, 12]", "trials=3: settle chooses it",
        "the sweep has only one", "optimizer.lr=1: tune chooses it", "strategy=none: one of argmax",
        "until=soon: settled is possible",
    ]  # fmt: skip
    assert len(errors) == len(expected)
    assert all(text in error for text, error in zip(expected, errors, strict=True))


def test_a_plan_is_whole_or_absent_and_a_damaged_one_is_told(tmp_path, monkeypatch):
    jobs = _Jobs.__new__(_Jobs)
    jobs.sweep = tmp_path
    for text in ("", "[]", '{"looks"'):
        (tmp_path / "settle.json").write_text(text)
        with pytest.raises(ConfigError, match=r"settle\.json plans looks=None"):
            jobs.record({"looks": [20]})
    (tmp_path / "settle.json").unlink()

    def killed(file):
        raise OSError("killed")

    monkeypatch.setattr(os, "fsync", killed)
    with pytest.raises(OSError, match="killed"):
        jobs.record({"looks": [20]})
    assert list(tmp_path.iterdir()) == []
