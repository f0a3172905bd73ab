"""The section Why: its tables, its words, and where its figures stand."""

import csv
import io
import re

import numpy as np
import pytest

from trl_explore.report import verdicts
from trl_explore.report.evidence import gather
from trl_explore.report.image_files import FIXED, inline_svg, theme_css
from trl_explore.report.loading import load
from trl_explore.report.writing import build_report


@pytest.fixture(scope="module")
def evidence(layouts):
    return gather(load([layouts]))


@pytest.fixture(scope="module")
def html(layouts, tmp_path_factory, make_job):
    folder = tmp_path_factory.mktemp("why")
    for strategy in ("argmax", "softmax"):  # the thesis's experiment comes first on a page
        make_job(folder / "thesis", strategy, [150, 160, 170], strategy=strategy)
    page, gaps = build_report([folder / "thesis", layouts], folder / "out")
    assert not gaps
    return page.read_text(encoding="utf-8")


def test_the_crossed_table_has_the_numbers_of_the_trials(evidence):
    part = next(p for p in evidence.groups if p.group.experiment == "corrections")
    table = verdicts.crossed_table(part)
    rows = list(csv.DictReader(io.StringIO(table.to_csv())))
    assert [r["row"] for r in rows] == ["argmax", "ε-greedy", "softmax"]
    by_name = {c.name: c for c in part.group.configurations}
    softmax = by_name["softmax,PerStep"]
    assert float(rows[2]["per-step ratio: restricted_mean"]) == softmax.durations.mean()
    assert float(rows[2]["per-step ratio: pass_rate"]) == 1.0
    middle = np.sort(softmax.durations)[3:5]
    assert middle[0] <= float(rows[2]["per-step ratio: median"]) <= middle[1]
    assert [c.title for c in table.columns[1:]] == [
        "uncorrected", "per-step ratio", "trajectory weights"
    ]  # fmt: skip


def test_what_the_corrections_do_stands_before_the_distance(html):
    section = html[html.index('<section id="why-section">') :]
    section = section[: section.index("</section>")]
    far = section.index("How far μ was from π</h3>")
    assert section.index('id="figure-corrections-effects"') < far
    assert far < section.index('id="figure-corrections-kl"')


def test_nothing_is_said_of_a_distance_that_was_not_recorded(tmp_path, make_job):
    sweep = tmp_path / "corrections"
    for correction in ("NoCorrection", "PerStep"):
        for k, strategy in enumerate(("argmax", "softmax")):
            make_job(sweep, f"{strategy},{correction}", [150 + 9 * k, 160, 170, 180, 190, 999],
                     strategy=strategy, groups={"correction": correction})  # fmt: skip
    page, _ = build_report([sweep], tmp_path / "out")
    text = page.read_text(encoding="utf-8")
    assert "Which conclusions survive" in text
    assert "The distance was recorded" not in text
    pairs = (tmp_path / "out" / "tables" / "corrections-pairs.md").read_text(encoding="utf-8")
    assert pairs.count("identical") == 2
    assert "not significant" not in pairs
    assert "The configurations differ in strategy and correction;" in text


def test_conclusions_show_both_verdicts(evidence):
    table = verdicts.conclusions_table(evidence.reexamined)
    assert len(table.records) == 10
    record = next(r for r in table.records if r["id"] == "outlook.acting_temperature_improves")
    assert record["outcome"] == "not measured"
    for record in table.records:
        assert record["outcome"] in verdicts.VERDICTS
        assert record["uncorrected_evidence"]


def test_the_section_says_what_the_ratio_does_not_correct(html):
    section = html[html.index('<section id="why-section">') :]
    section = section[: section.index("</section>")]
    text = re.sub(r"\s+", " ", re.sub("<[^>]*>", "", section))
    assert re.search("corrects the choice of action, but not [^.]*states", text)
    assert "No weight can correct argmax." in text
    assert 'id="why-conclusions"' in section
    assert 'id="corrections-crossed"' in section
    for kind in ("kl", "effective_sample_size", "ratio_mean"):
        assert f'id="figure-corrections-{kind}"' in section
        assert html.count(f'id="figure-corrections-{kind}"') == 1


def test_without_corrections_there_is_no_such_section(made):
    assert 'id="why-section"' not in made.html


def test_every_id_of_the_page_is_unique(html):
    ids = re.findall(r'\bid="([^"]+)"', html)
    assert len(ids) == len(set(ids))


def test_the_colours_of_a_map_stay_as_they_are():
    color, ink = sorted(FIXED)[:2]
    svg = f'<svg viewBox="0 0 1 1"><path style="fill: {color}; stroke: #0072b2"/></svg>'
    page = inline_svg(svg, "x", "a map")
    assert f"fill: {color}" in page
    assert "stroke: var(--c0072b2)" in page
    css = theme_css([svg, ink])
    assert "0072b2" in css
    assert color not in css
