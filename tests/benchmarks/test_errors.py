"""Every claim, decided on samples of a population whose truth is known: a wrong verdict is rare.

``population.npz`` has 500 trials of each configuration from the runs of docs/statistics.md, which
repeats this with all of their trials.
"""

import importlib
from pathlib import Path

import pytest

from trl_explore.thesis import CLAIMS, Study

HERE = Path(__file__).resolve().parent
TIMED = [claim for claim in CLAIMS if claim.id.startswith("time.") or "least_time" in claim.id]


@pytest.fixture
def errors(monkeypatch):
    monkeypatch.syspath_prepend(HERE.parents[1] / "benchmarks")
    return importlib.import_module("errors")


@pytest.mark.parametrize(("timed", "repetitions"), [(False, 30), (True, 8)])
def test_a_definite_verdict_is_rarely_wrong(errors, timed, repetitions):
    study = Study(errors.load(HERE / "population.npz"))
    claims = [claim for claim in CLAIMS if (claim in TIMED) == timed]
    rows = list(errors.verdicts(study, (30, 100), repetitions, claims))
    assert len(rows) >= len(claims) - 1  # without evaluations, one is not measured
    for name, truth, *cells in rows:
        wrong = [float(cell) for cell in cells[1::2]]
        # At most 5 %, and what 30 samples may show of 5 %: 1 - B(4; 30, 0.05) = 0.016.
        assert max(wrong) <= 100 * 4 / 30, (name, truth, wrong)
    decided = [float(cell) for row in rows for cell in row[2::2]]
    assert sum(decided) / len(decided) > 20


def test_a_table_is_replaced_in_its_page(errors, tmp_path):
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- x -->\nold\n<!-- end of x -->\nb\n", encoding="utf-8")
    errors.write(page, "x", "new")
    assert page.read_text() == "a\n<!-- x -->\nnew\n<!-- end of x -->\nb\n"
