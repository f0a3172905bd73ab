"""A study file: what it asks, what it claims, and the answers to wrong values."""

from __future__ import annotations

from pathlib import Path

import pytest

from trl_explore.jobs.files import ResultsError
from trl_explore.report.evidence import Evidence, gather
from trl_explore.report.loading import load
from trl_explore.report.methods import paragraph
from trl_explore.report.study_file import read_study
from trl_explore.report.writing import build_report
from trl_explore.thesis import FAILS, HOLDS, NOT_MEASURED, Claim

FAST = [150 + k for k in range(20)]
SLOW = [500 + 7 * k for k in range(20)]

STUDY = """
title: Softmax or ε-greedy?
question: Which one learns faster?
configurations: [runs/*]
compare:
  - effect_of: strategy
    at_each: correction
  - [{strategy: softmax, correction: none}, {strategy: softmax, correction: per_step}]
measures: [passed]
level: 0.9
leave_out: ["*pilot*"]
claims:
  - statement: Softmax passes almost always.
    passes: {of: {strategy: softmax, correction: none}, above: 0.8}
  - statement: Softmax needs more iterations.
    less: {first: {strategy: epsilon_greedy, correction: none},
           second: {strategy: softmax, correction: none}}
  - statement: Both of these.
    all:
      - mean: {of: {strategy: softmax, correction: none}, low: 100, high: 400}
      - not: {never_passes: {of: {strategy: softmax, correction: none}}}
  - statement: Softmax converges earlier.
    faster: {first: {strategy: softmax, correction: none},
             second: {strategy: epsilon_greedy, correction: none}}
  - statement: Of nothing.
    passes: {of: argmax, below: 0.5}
  - thesis: score.softmax_passes_consistently
"""


@pytest.fixture
def study(tmp_path: Path, make_job) -> Path:
    sweep = tmp_path / "runs" / "train"
    for strategy, taken, own in (
        ("softmax", FAST, {"temperature": 1.0}), ("epsilon_greedy", SLOW, {"epsilon": 0.3}),
    ):  # fmt: skip
        for correction in ("NoCorrection", "PerStep"):
            make_job(sweep, f"{strategy},{correction}", taken, strategy=strategy, parameters=own,
                     groups={"correction": correction})  # fmt: skip
    make_job(sweep, "pilot", [150], strategy="argmax", cap=500)
    path = tmp_path / "mine.yaml"
    path.write_text(STUDY, encoding="utf-8")
    return path


def ask(path: Path) -> Evidence:
    asked = read_study(path)
    return gather(load(asked.folders), asked)


def test_a_study_asks_its_own_questions_and_checks_its_own_claims(study, tmp_path):
    asked = read_study(study)
    found = gather(load(asked.folders), asked)
    (group,) = found.groups
    assert [a.question.of for a in group.answered] == ["strategy", "correction"]
    assert [len(a.comparisons) for a in group.answered] == [2, 1]
    assert group.comparisons[0].difference.level == pytest.approx(1 - 0.1 / 3)
    assert [c.finding.verdict for c in found.checked] == [
        HOLDS, FAILS, HOLDS, HOLDS, NOT_MEASURED, NOT_MEASURED
    ]  # fmt: skip
    page, _ = build_report(asked.folders, tmp_path / "out", asked)
    html = page.read_text(encoding="utf-8")
    assert "<title>Softmax or ε-greedy?</title>" in html
    assert "Which one learns faster?" in html
    assert "Softmax passes almost always." in html
    assert "inferred" not in html
    files = {p.name for p in (tmp_path / "out").rglob("*") if p.is_file()}
    assert {"methods.md", "references.bib", "settings.csv", "settings.tex"} <= files
    assert any(name.endswith(".pdf") for name in files)
    latex = next((tmp_path / "out" / "tables").glob("*-configurations.tex")).read_text()
    assert r"20 of 20 [88, 100] \%" in latex
    methods = (tmp_path / "out" / "methods.md").read_text(encoding="utf-8")
    assert "80 independent agents (4 configurations" in methods
    assert "differed in strategy and correction" in methods


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("measures: [passed]", "measures: [speed]", ["measures", "'speed'", "passed, score"]),
        ("level: 0.9", "level: 95", ["level=95", "0.5 to below 1"]),
        ("title:", "titel:", ["titel", "the keys are title"]),
        ("[runs/*]", "[nothing/*]", ["configurations='nothing/*'", "no such folder"]),
        ("effect_of: strategy", "effect_of: stratgy", ["compare[0]", "'stratgy'", "correction"]),
        ("effect_of:", "effects:", ["compare[0]", "effect_of: FACTOR"]),
        ("above: 0.8", "above: 80", ["claims[0].passes.above=80", "between 0 and 1"]),
        ("passes: {of: argmax", "pass: {of: argmax", ["claims[4]", "passes, never_passes"]),
        ("*pilot*", "*nobody*", ["leave_out", "fits no job"]),
        ("{strategy: softmax, correction: per_step}]", "vdbe]", ["compare[1]", "'vdbe' fits 0"]),
        ("correction: per_step}]", "correction: none}]", ["compare[1]: both are the same"]),
        ("low: 100, high: 400", "low: 400, high: 100", ["high=100", "more than low=400"]),
        ("score.softmax_passes_consistently", "nothing", ["claims[5]", "score.random_never"]),
        ("claims:", "claims: {", ["not readable as YAML"]),
        ("level:", "until: soon\nlevel:", ["until='soon'", "settled is possible"]),
        ("level:", "until: settled\nlevel:", ["until='settled'", "a sweep among"]),
    ],
)
def test_a_wrong_value_is_one_line_with_key_value_and_what_is_allowed(study, old, new, words):
    study.write_text(STUDY.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ResultsError) as error:
        ask(study)
    text = str(error.value)
    assert "\n" not in text
    for word in ("mine.yaml", *words):
        assert word in text


def test_that_what_was_learned_is_unknown_is_told(study):
    study.write_text(STUDY.replace("[passed]", "[learned]"), encoding="utf-8")
    (group,) = ask(study).groups
    assert "What was learned is unknown (" in group.group.notes[-1]
    assert "the results are those of passing" in group.group.notes[-1]


def test_factors_that_change_together_can_be_asked_for_as_one(study):
    text = STUDY.replace("effect_of: strategy\n    at_each: correction",
                         "effect_of: [strategy, correction]")  # fmt: skip
    study.write_text(text, encoding="utf-8")
    asked = read_study(study)
    group = gather(load(asked.folders), asked).groups[0]
    assert group.answered[0].question.of == "strategy and correction together"
    assert len(group.answered[0].comparisons) == 6


def test_a_pair_that_two_questions_ask_for_is_tested_once(study):
    """Three pairs; the second question repeats one of them in the other order."""
    pair = "  - [{strategy: softmax, correction: none}, {strategy: softmax, correction: per_step}]"
    same = "[{strategy: softmax, correction: none}, {strategy: epsilon_greedy, correction: none}]"
    study.write_text(STUDY.replace(pair, f"{pair}\n  - {same}"), encoding="utf-8")
    (group,) = ask(study).groups
    assert [len(a.comparisons) for a in group.answered] == [2, 1, 1]
    assert {b.where for a in group.answered for b in a.question.blocks} == {
        "uncorrected", "per-step ratio", "softmax"
    }  # fmt: skip
    assert len(group.comparisons) == 3


@pytest.mark.parametrize("fails", [True, False])
def test_a_study_of_scores_speaks_of_scores_only(tmp_path, make_job, fails):
    """Final scores of 196.00 to 196.19, against 20 to 39 or against the same."""
    taken = [1000] * 20 if fails else FAST
    make_job(tmp_path / "train", "softmax", FAST)
    make_job(tmp_path / "train", "argmax", taken, strategy="argmax")
    path = tmp_path / "mine.yaml"
    path.write_text("configurations: [train/*]\nmeasures: [score]", encoding="utf-8")
    found = ask(path)
    (said,) = found.answer
    if fails:
        assert said.startswith("The final scores differ significantly, after Holm’s correction: so")
        assert "196 against argmax 29.5 (difference 167 [" in said
    else:
        assert said == "No final scores differ significantly in 1 pair."
    path.write_text("configurations: [train/*]\nmeasures: [passed]", encoding="utf-8")
    assert ask(path).groups[0].scores == []
    assert not any("scores" in sentence for sentence in ask(path).answer)


def test_an_effect_can_be_asked_for_at_each_environment(tmp_path, make_job):
    """Each environment is a section of its own, and the methods state its threshold."""
    for env, threshold in (("CartPole-v1", 195.0), ("Acrobot-v1", -100.0)):
        for strategy, taken in (("softmax", FAST), ("argmax", SLOW)):
            make_job(tmp_path / "train", f"{env},{strategy}", taken, strategy=strategy, env=env,
                     threshold=threshold)  # fmt: skip
    path = tmp_path / "mine.yaml"
    text = "configurations: [train/*]\ncompare: [{effect_of: strategy, at_each: environment}]"
    path.write_text(text, encoding="utf-8")
    found = ask(path)
    assert [len(g.answered) for g in found.groups] == [1, 1]
    methods = paragraph(found)
    assert "exceeded -100 on Acrobot-v1 (cap: 1,000 iterations) or its mean" in methods
    assert "exceeded 195 on CartPole-v1" in methods
    assert "The 2 comparisons were corrected" in methods
    path.write_text(text.replace("effect_of: strategy", "effect_of: env"), encoding="utf-8")
    with pytest.raises(ResultsError, match="'env' does not vary among configurations with the"):
        ask(path)


def test_every_claim_of_a_study_has_a_definition(study):
    from trl_explore.report.selecting import own_claims

    asked = read_study(study)
    assert isinstance(asked.claims, tuple)
    claims: list[Claim] = own_claims(asked.claims, "mine")
    assert all(claim.definition.endswith(".") for claim in claims)
    assert len(claims) == 6


def test_a_symbol_keeps_its_capital_within_a_sentence(tmp_path, make_job):
    """T is a temperature; t would be a time step."""
    for name, temperature, base in (("low", 0.5, 300), ("one", 1.0, 140)):
        make_job(
            tmp_path / "sweep", name, [base + k for k in range(20)], strategy="softmax",
            parameters={"temperature": temperature}, evaluate_every=20,
            learned=[base - 100 + k for k in range(20)],
        )  # fmt: skip
    (part,) = gather(load([tmp_path / "sweep"])).groups
    (said,) = (s for s in part.sentences if "learns fastest" in s)
    assert said.startswith("Judged by what was learned, T = 1 learns fastest")
