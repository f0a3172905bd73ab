"""Acting, bias and data: the cells found, numbers by hand, the sentences and the tables."""

from __future__ import annotations

import csv
import re
from dataclasses import replace

import numpy as np
import pytest

from trl_explore.report.crossings import Cell, crossings
from trl_explore.report.curves import Heights
from trl_explore.report.decomposition import decompose
from trl_explore.report.figures import draw_why
from trl_explore.report.study_file import StudyFile
from trl_explore.report.why import decomposition_tables, headline
from trl_explore.report.writing import build_report
from trl_explore.statistics.outcomes import judged

EPSILON, T = {"epsilon": 0.3}, {"temperature": 1.0}


def run(make, learned, strategy="softmax", parameters=T, heights=None, **more):
    """A run whose trials pass 100 iterations after they learn; every value counts 12 times."""
    learned = 12 * list(learned)
    o = make([n + 100 for n in learned], strategy=strategy, parameters=parameters,
             learned=learned, **more)  # fmt: skip
    of = None
    if heights is not None:
        behaved, evaluated = (np.array(12 * x, dtype=float) for x in heights)
        of = Heights([(0, k) for k in range(len(learned))], evaluated, evaluated, behaved)
    return Cell("CartPole-v1", judged(o, "passed"), judged(o, "learned"), of)


@pytest.fixture
def runs(make):
    ratio, plain = {"correction": "PerStep"}, {"correction": "NoCorrection"}
    return [
        run(make, [40, 50, 45, 41], groups=plain,
            heights=([100, 110, 104, 102], [300, 320, 310, 306])),
        run(make, [340, 360, 345, 331], "epsilon_greedy", EPSILON, groups=plain,
            heights=([60, 50, 56, 58], [200, 210, 204, 202])),
        run(make, [70, 82, 74, 70], "epsilon_greedy", EPSILON, groups=ratio),
        run(make, [310, 315, 312, 308], assumes=EPSILON),
        run(make, [446, 447, 443, 445], "argmax", None, groups=plain),
        run(make, [444, 449, 446, 442], "argmax", None, groups=ratio),
        run(make, [46, 47, 43, 45], "decaying_epsilon_greedy", None, groups=plain),
        run(make, [44, 49, 46, 42], "decaying_epsilon_greedy", None, groups=ratio),
    ]  # fmt: skip


def test_the_cells_of_a_strategy_are_found_in_any_experiment(runs):
    runs[3] = replace(runs[3], passed=replace(runs[3].passed, experiment="another"))
    found = {c.label: c for c in crossings(runs)}
    assert set(found) == {"ε-greedy", "argmax", "decaying ε-greedy"}
    assert found["ε-greedy"].cells == {
        "reference": runs[0], "plain": runs[1], "corrected": runs[2], "assumed": runs[3],
    }  # fmt: skip
    assert "assumed" not in found["argmax"].cells


def test_other_agents_and_other_rules_are_no_cells(runs, make):
    clipped = runs[2].passed.config | {"correction": {"_target_": "x.PerStep", "clip": 2.0}}
    other = replace(runs[2], passed=replace(runs[2].passed, config=clipped))
    biased = run(make, [310, 315, 312, 308], assumes={"epsilon": 0.5})
    longer = replace(runs[2], passed=replace(runs[2].passed, cap=5000))
    assert crossings([runs[0], runs[1], other, biased, longer]) == []
    assert crossings(runs[1:]) == []  # without softmax


def test_two_maps_of_one_environment_are_two_environments(make):
    def cells(**kwargs):
        made = [
            run(make, [40, 50], groups={"correction": "NoCorrection"}),
            run(make, [90, 95], "argmax", None, groups={"correction": "NoCorrection"}),
            run(make, [90, 95], "argmax", None, groups={"correction": "PerStep"}),
        ]
        env = {"id": "FrozenLake-v1", "kwargs": kwargs}
        return [replace(r, passed=replace(r.passed, config={**r.passed.config, "env": env}))
                for r in made]  # fmt: skip

    small, large = cells(), cells(map_name="8x8")
    other = [replace(r, passed=replace(r.passed, cap=2000)) for r in small]
    found = crossings([*small, *large, *other])
    assert [c.environment for c in found] == [
        "CartPole-v1", "CartPole-v1, 2", "CartPole-v1, 3"
    ]  # fmt: skip
    assert [c.label for c in found] == 3 * ["argmax"]


def test_one_and_1_0_are_the_same_strategy(make):
    plain, ratio = {"correction": "NoCorrection"}, {"correction": "PerStep"}
    cells = [
        run(make, [40, 50], parameters={"temperature": 1}, groups=plain),
        run(make, [90, 80], parameters={"temperature": 2}, groups=plain),
        run(make, [60, 50], parameters={"temperature": 2.0}, groups=ratio),
    ]
    (found,) = crossings(cells)
    assert found.label == "softmax, T = 2"


def test_the_parts_by_hand(runs):
    greedy = decompose(runs)[0]
    learning = greedy.parts["learning"]
    # Means: softmax 44, ε-greedy 344, corrected 74, softmax with its bias 311.25.
    assert (learning.reference, learning.plain, learning.n) == (44, 344, 48)
    assert learning.gap.value == 300
    assert learning.corrected is not None
    assert learning.assumed is not None
    assert learning.data is not None
    assert learning.corrected.value == pytest.approx(270 / 300)
    assert learning.assumed.value == pytest.approx(267.25 / 300)
    assert learning.bias.value == pytest.approx((270 + 267.25) / 600)
    assert learning.data.value == 30
    assert not learning.told_apart  # one failure that was not seen may cost as much
    assert decompose(runs)[1].parts["learning"].told_apart
    assert greedy.parts["passing"].gap.value == 300
    acting = greedy.acting["plain"]
    assert (acting.behaved.value, acting.learned.value, acting.handicap.value) == (56, 204, 148)
    # Behaved: 48 less than softmax. Its handicap is 148 against softmax's 205.
    assert greedy.acting_share is not None
    assert greedy.acting_share.value == pytest.approx((148 - 205) / 48)
    assert greedy.passes == (48, 48, 48)


def test_what_is_not_measured_is_left_out(runs):
    bare = [replace(r, learned=None, heights=None) for r in runs]
    greedy = decompose(bare)[0]
    assert set(greedy.parts) == {"passing"}
    assert greedy.acting == {}
    assert greedy.acting_share is None
    acting, *rest = headline(decompose(bare))
    assert acting.startswith("Bias:")
    assert "of the time to passing" in acting
    assert rest == []
    assert list(draw_why(decompose(bare))) == []


def test_two_ways_that_disagree_are_not_averaged(runs):
    runs[3] = replace(runs[3], learned=runs[2].learned)  # the bias under softmax: 30 of 300
    found = decompose(runs)
    assert not found[0].parts["learning"].separable
    assert found[1].parts["learning"].separable
    bias = headline(found)[1]
    assert re.search(r" 10 % \[.*\], added to softmax, to 90 % \[.*\], removed from ε-", bias)


def test_the_headline_says_what_comes_out(runs):
    acting, bias, data = headline(decompose(runs))
    assert "ε-greedy scores 56.0 with its exploration and 204 without it" in acting
    assert "softmax 104 and 309" in acting
    assert re.search(r"90 % \[\d+, \d+\] of the 300 iterations that ε-greedy needs more", bias)
    assert "(344 against 44.0)" in bias
    assert re.search(
        r"0 % \[.*\], removed from argmax, of the 401 iterations that argmax needs more", bias
    )
    assert re.search(r"no share can be .* decaying ε-greedy, .* \(1\.25 \[.* too small\.", bias)
    assert re.search(
        r"ε-greedy and decaying ε-greedy do not differ significantly from softmax", data
    )
    assert re.search(r"argmax needs 401 \[\d.*\] iterations more than softmax", data)
    assert headline([]) == ()


def test_where_nobody_learns_the_score_is_spoken_of(make):
    """All at the cap: iterations tell nothing, learned scores do."""

    def job(level, correction, **more):
        o = make(20 * [1000], learned=20 * [None], groups={"correction": correction}, **more)
        height = level + np.tile([0.0, 0.01], 10)
        of = Heights([(0, k) for k in range(20)], height, height, height)
        return Cell("FrozenLake-v1", judged(o, "passed"), judged(o, "learned"), of)

    greedy = {"strategy": "epsilon_greedy", "parameters": EPSILON}
    cells = [
        job(0.6, "NoCorrection", parameters=T),
        job(0.1, "NoCorrection", **greedy),
        job(0.5, "PerStep", **greedy),
    ]
    _, bias, data = headline(decompose(cells))
    assert "of the mean learned score, this explains 80 % [80, 80], removed" in bias
    assert "ε-greedy has less than softmax (0.105 against 0.605)" in bias
    assert "ε-greedy has 0.1 [0.1, 0.1] points less than softmax" in data


def test_shares_of_nothing_are_not_estimable(runs):
    main, every = decomposition_tables(decompose(runs))
    decaying = next(row for row in main.rows() if row[0] == "decaying ε-greedy")
    assert "not estimable" in decaying
    assert "nan" not in main.to_markdown() + every.to_markdown()
    assert {r["quantity"] for r in every.records} == {"learning", "passing", "learned_score"}


def test_the_tests_are_corrected_over_the_strategies(runs):
    alone = decompose([runs[0], *runs[4:6]])[0].parts["learning"].p_data
    of_three = decompose(runs)[1].parts["learning"].p_data
    assert alone is not None
    assert of_three == pytest.approx(3 * alone)


def test_the_report_shows_both_measures_and_their_parts(tmp_path):
    from tests.report.conftest import write_crossing

    sweep = write_crossing(tmp_path / "corrections")
    page, _ = build_report([sweep], tmp_path / "out", StudyFile(level=0.88))
    text = page.read_text(encoding="utf-8")
    section = text[text.index('<section id="why-section">') :]
    section = section[: section.index("</section>")]
    assert section.index('id="figure-why-acting-1"') < section.index('id="why-parts"')
    assert section.index('id="why-parts"') < section.index('id="why-conclusions"')
    assert text.index("Acting: ") < text.index("Bias: ") < text.index("Data: ")
    assert 'id="figure-corrections-survival-learned-panels"' in text
    with (tmp_path / "out" / "tables" / "why-parts.csv").open() as file:
        rows = {row["strategy"]: row for row in csv.DictReader(file)}
    assert float(rows["ε-greedy"]["learning_bias"]) == pytest.approx(0.9, abs=0.03)
    assert float(rows["argmax"]["learning_bias"]) == pytest.approx(0, abs=0.03)
    with (tmp_path / "out" / "tables" / "corrections-configurations.csv").open() as file:
        row = next(
            r for r in csv.DictReader(file) if r["configuration"] == "softmax, bias of x 0.3"
        )
    assert float(row["learned_restricted_mean"]) == pytest.approx(310, abs=6)
    assert float(row["learned_score_mean"]) == pytest.approx(319.5)
    # The level reaches every caption, sentence and table; 0.88 has no Bonferroni level of 0.95.
    texts = [p.read_text(encoding="utf-8") for p in (tmp_path / "out").rglob("*.md")]
    for each in (re.sub(r"<(svg|style)\b.*?</\1>", "", text, flags=re.S), *texts):
        assert not re.search(r"95(\.0)? ?%|0\.95", each)
    assert text.count("88 % interval") > 5
