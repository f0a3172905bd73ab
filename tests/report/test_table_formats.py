from __future__ import annotations

import csv
import io
from html.parser import HTMLParser
from typing import Any

import pytest

from trl_explore.report.page import environment
from trl_explore.report.table_formats import Column, Table

TABLE = Table(
    "t",
    "A & B",
    [
        Column("name", "name", lambda r: r["name"]),
        Column("value", "value", lambda r: f"{r['value']:.1f}", numeric=True),
    ],
    [{"name": "<b>|_&", "value": 1.26, "hidden": None}, {"name": "ε", "value": float("inf")}],
    main=True,
)


class Cells(HTMLParser):
    """The tables of a page: id -> list of rows of (data-label, data-value)."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: dict[str, list[list[tuple[str, str]]]] = {}
        self.current = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given: dict[str, Any] = dict(attrs)
        if tag == "table":
            self.current = given["id"]
            self.tables[self.current] = []
        elif tag == "tr":
            self.tables[self.current].append([])
        elif tag == "td":
            self.tables[self.current][-1].append((given["data-label"], given["data-value"]))


def test_csv_has_everything_in_full():
    assert TABLE.to_csv() == "name,value,hidden\n<b>|_&,1.26,\nε,inf,\n"


def test_html_is_escaped_and_carries_the_value():
    html = str(environment().get_template("parts.html").module.table(TABLE))  # type: ignore[attr-defined]
    assert "<b>" not in html
    assert 'data-value="1.26" data-label="value">1.3</td>' in html
    assert "<caption>A &amp; B</caption>" in html


def test_markdown_is_escaped():
    assert TABLE.to_markdown().splitlines()[2] == r"| &lt;b&gt;\|\_&amp; | 1.3 |"


def test_latex_is_escaped():
    latex = TABLE.to_latex()
    assert r"\textless{}b\textgreater{}|\_\& & 1.3 \\" in latex
    assert r"$\varepsilon$ & inf \\" in latex
    assert r"\begin{tabular}{lr}" in latex


def test_the_tables_of_the_page_hold_the_numbers_of_the_csv(made):
    parser = Cells()
    parser.feed(made.html)
    compared = 0
    folded = [parser.tables.pop(name, []) for name in ("claims-more", "claims-missing")]
    parser.tables["claims"] += [row for rows in folded for row in rows]
    for name, rows in parser.tables.items():
        text = (made.out / "tables" / f"{name}.csv").read_text(encoding="utf-8")
        records = list(csv.DictReader(io.StringIO(text)))
        cells = [row for row in rows if row]
        assert len(cells) == len(records)
        if name == "claims":  # the page puts those that were not measured last
            place = {dict(row)["the thesis says"]: k for k, row in enumerate(cells)}
            records.sort(key=lambda record: place[record["statement"]])
        for row, record in zip(cells, records, strict=True):
            for _, value in row:
                assert value in record.values()
                compared += 1
    assert compared > 300


def test_the_summary_is_that_of_the_trials(made):
    import pandas as pd

    summary = pd.read_csv(made.out / "tables" / "thesis-configurations.csv").set_index("strategy")
    for name in ("random", "softmax", "argmax"):
        trials = pd.read_csv(made.study / "thesis" / name / "trials.csv")
        assert summary.loc[name, "converged"] == trials["converged"].sum()
        assert summary.loc[name, "restricted_mean"] == pytest.approx(trials["iterations"].mean())
        assert summary.loc[name, "score_mean"] == pytest.approx(trials["score"].mean())
        assert summary.loc[name, "frames_total"] == trials["frames"].sum()


def test_the_main_tables_exist_in_every_form(made):
    for name in ("claims", "thesis-configurations", "thesis-pairs", "decay_grid-pairs"):
        for ending in ("csv", "tex", "md"):
            assert (made.out / "tables" / f"{name}.{ending}").stat().st_size > 100


@pytest.mark.parametrize("text", ["=cmd|' /C calc'!A0", "+1+1", "-2+3", "@SUM(A1)", "\t=1", "\r=1"])
def test_a_spreadsheet_runs_no_cell(text):
    """Names come from folders, which may be somebody else's."""
    table = Table("t", "T", [], [{"name": text, "=key": -1.5}])
    header, row = csv.reader(io.StringIO(table.to_csv(), newline=""))
    assert header == ["name", "'=key"]
    assert row == ["'" + text.replace("\r", " "), "-1.5"]
