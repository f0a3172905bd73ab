"""The map: which cells it has, what it says of them, and how long it takes."""

from __future__ import annotations

import json
import re
import sys

import numpy as np
import pandas as pd
import pytest

from trl_explore.commands import map as command
from trl_explore.jobs.reading import read_job
from trl_explore.show.map import DRAWINGS, point_of, read_cells
from trl_explore.statistics.estimates import pass_rate


def test_the_full_map_has_the_triangle_and_the_strategies_of_the_thesis():
    full = list(command.plan(full=True))
    assert len(set(full)) == len(full) >= 200
    points = command.triangle(5)
    assert len(points) == 21
    assert np.allclose(np.sum(points, axis=1), 1)
    assert {(1, 0, 0), (0, 1, 0), (0, 0, 1)} <= set(points)
    for greedy, softmax, uniform in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0.7, 0, 0.3)):
        words = f"greedy={float(greedy)} strategy.softmax={float(softmax)}"
        words += f" strategy.uniform={float(uniform)} strategy.temperature=1.0"
        assert sum(words in job for job in full) == 6  # environments and corrections
    assert sum("strategy=decaying_epsilon_greedy" in job for job in full) == 6
    assert len(list(command.plan(full=False))) < 50


def test_a_cell_has_the_numbers_of_its_job(made_map):
    cells = made_map.found["cells"]
    assert len(cells) == 9
    (cell,) = (c for c in cells if c["w"] == [0.4, 0.4, 0.2] and c["corrected"])
    (job,) = (j for j in (made_map.jobs / "train").glob("mixture,correction=*"))
    outcomes = read_job(job)
    assert outcomes.passed is not None
    rate = pass_rate(int(outcomes.passed.sum()), 5)
    assert cell["passed"]["rate"] == pytest.approx([rate.value, rate.low, rate.high], rel=1e-3)
    assert cell["passed"]["mean"][0] == pytest.approx(outcomes.iterations_to_pass.mean(), rel=1e-3)
    assert cell["score"][0] == pytest.approx(outcomes.score.mean(), rel=1e-3)
    times, alive = cell["passed"]["survival"][:2]
    assert alive[-1] == pytest.approx(1 - rate.value)
    assert times[-1] == outcomes.iterations_to_pass.max()
    rows = pd.read_csv(job / "evaluations.csv")
    first = rows[(rows.iteration == 0) & (rows.purpose == "scheduled")].score
    at, mean, low, high, behaved = cell["curve"]
    assert at == [0, 5, 6]
    assert mean[0] == pytest.approx(first.mean(), rel=1e-3)
    assert low[0] <= mean[0] <= high[0]
    assert len(behaved) == 3


def test_a_film_is_an_episode_of_the_typical_agent(made_map):
    """Its states are those of the environment: the score counts them."""
    for cell in made_map.found["cells"]:
        film, kind = cell["film"], made_map.found["tasks"][cell["task"]]["kind"]
        columns = film["states"]
        assert {len(column) for column in columns} == {film["steps"] + 1}
        assert len(film["actions"]) == film["steps"]
        if kind == "cartpole":
            fallen = abs(columns[0][-1]) > 2400 or abs(columns[1][-1]) > 209
            assert fallen == film["terminated"]
            assert film["score"] == film["steps"]
        elif kind == "catch":
            assert columns[0] == list(range(6))
            assert film["score"] == (1 if columns[1][-1] == columns[2][-1] else -1)
            moves = np.diff(columns[2])
            wanted = np.array([int(a) - 1 for a in film["actions"]])
            assert ((moves == wanted) | (moves == 0)).all()
        else:
            assert columns[0][0] == 0


def test_only_a_policy_that_acts_against_itself_explores(made_map):
    for cell in made_map.found["cells"]:
        if cell["w"] == [1.0, 0.0, 0.0] and not cell["decays"]:
            assert cell["film"]["exploratory"] == []


def test_other_strategies_have_no_place(made_map, tmp_path):
    assert point_of({"strategy": {"_target_": "trl_explore.strategies.VDBE"}}) is None
    scheduled = {"_target_": "x.FullMixture", "greedy": {}, "softmax": 1, "uniform": 1}
    assert point_of({"strategy": scheduled}) is None
    with pytest.raises(ValueError, match="no finished job of strategy=mixture"):
        read_cells(tmp_path)


def test_the_page_has_all_data_and_needs_no_network(made_map):
    html = made_map.html
    data = json.loads(re.search(r'id="data">(.*?)</script>', html, flags=re.S)[1])
    assert [task["id"] for task in data["tasks"]] == list(DRAWINGS)
    assert len(data["cells"]) == 9
    assert not re.search(r'(src|href)="', html)
    assert "http" not in html.replace("http://www.w3.org/2000/svg", "")


def test_the_command_writes_the_page_of_finished_cells(made_map, tmp_path, monkeypatch, capsys):
    out = tmp_path / "map.html"
    words = ["--page", "--jobs", str(made_map.jobs), "--out", str(out)]
    monkeypatch.setattr(sys, "argv", ["trl-explore map", *words])
    assert command.main() == 0
    assert capsys.readouterr().out == f"{out}\n"
    assert out.read_text(encoding="utf-8") == made_map.html
    monkeypatch.setattr(sys, "argv", ["trl-explore map", "--page", "--jobs", str(tmp_path)])
    assert command.main() == 1
    assert capsys.readouterr().err.startswith("error: ")
