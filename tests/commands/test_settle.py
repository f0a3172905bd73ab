"""``settle`` as a user runs it, with jobs of a few iterations."""

from __future__ import annotations

import csv
import subprocess
import sys

PROGRAM = """
import os
from trl_explore.commands.main import main
for words in {calls}:
    os.environ.pop("HYDRA_FULL_ERROR", None)  # else the second call shows tracebacks
    print("status", main(["settle", *words]), flush=True)
"""


def test_settle_adds_trials_where_they_are_needed_and_continues(tmp_path):
    sweep = [
        "strategy=softmax,random", "max_iterations=30", "score_window=5",
        "score_threshold=25", "evaluate_every=0", "episodes=false", f"output_dir={tmp_path}",
    ]  # fmt: skip
    calls = [
        ["--first", "6", "--most", "9", *sweep],
        ["--first", "6", "--most", "9", *sweep],
        ["--first", "6", "--most", "12", *sweep],
        [*sweep, "trials=3"],
        ["strategy=softmax", "max_iterations=2", f"output_dir={tmp_path / 'one'}"],
    ]
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROGRAM.format(calls=calls)],
        capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip
    statuses = [line for line in run.stdout.splitlines() if line.startswith("status")]
    assert statuses == ["status 0", "status 0", "status 1", "status 1", "status 1"], run.stderr
    with (tmp_path / "train" / "settle.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(r["first"], r["second"]) for r in rows] == [("softmax,temperature=1.0", "random")]
    assert all(r["greater mean"] in ("open", r["first"], r["second"]) for r in rows)
    assert all((r["greater mean"] != "open") or r["trials"] == "9" for r in rows)
    # The command that is repeated runs nothing and says the same.
    first, second = run.stdout.split("status 0")[:2]
    assert [x for x in first.splitlines() if "trials of at most" in x] == [
        x for x in second.splitlines() if "trials of at most" in x
    ]
    jobs = {path.name for path in (tmp_path / "train").iterdir() if path.is_dir()}
    assert any("first_trial=6" in name for name in jobs)
    errors = [line for line in run.stderr.splitlines() if line.startswith("error: ")]
    assert "settle.json plans looks=[6, 9], not [6, 9, 12]" in errors[0]
    assert "trials=3: settle chooses it" in errors[1]
    assert "the sweep has only one" in errors[2]
