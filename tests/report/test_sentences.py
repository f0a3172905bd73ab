"""The sentences on the fastest strategy, significant differences and options."""

import re

import numpy as np
import pytest

from tests.statistics import conftest
from trl_explore.report.factors import Factor
from trl_explore.report.layouts import option_sentences, plane_sentences
from trl_explore.report.questions import Block, Question
from trl_explore.report.sentences import answer, question_sentence, verdicts
from trl_explore.statistics.comparisons import compare_all, compare_pairs
from trl_explore.thesis import CLAIMS, Checked, Finding, Study, Verdict, check_claims

make, rng = conftest.make, conftest.rng


@pytest.fixture
def jobs(make, rng):
    return [
        make([1000] * 30, strategy="random"),
        make(rng.integers(300, 600, size=30), strategy="epsilon_greedy"),
        make(rng.integers(100, 200, size=30), strategy="softmax"),
    ]


def everything(jobs, **options):
    comparisons = compare_all(jobs)
    checked = check_claims(Study(jobs))
    return *answer(jobs, comparisons, **options), *verdicts(checked)


def test_a_clear_winner(jobs):
    first, second, third = everything(jobs)
    mean, margin = jobs[2].iterations.mean(), (jobs[1].iterations - jobs[2].iterations).mean()
    assert re.match(f"Softmax .*fastest of 3 .* {mean:.0f} iterations", first)
    assert re.search(f" {margin:.0f} fewer .*epsilon_greedy .*95 % interval", first)
    assert "30 of 30 trials" in first
    assert second.startswith("3 of 3 pairs")
    assert "random never" in second
    assert f" {len(CLAIMS)} statements" in third
    assert all(s.count(". ") == 0 and s.endswith(".") for s in (first, second, third))


def test_the_margin_does_not_depend_on_the_order(jobs):
    assert everything(jobs)[0].split("(95")[0] == everything(jobs[::-1])[0].split("(95")[0]


def test_nobody_wins_by_a_mean(make, rng):
    t = rng.integers(100, 400, size=30)
    jobs = [make(t), make(t + rng.integers(-50, 51, size=30), strategy="argmax")]
    first, second, _ = everything(jobs)
    assert re.match("No .* 2 .*fastest", first)
    assert "softmax" in first
    assert "argmax" in first
    assert second.startswith("0 of 1 pair")
    assert "softmax and argmax" in second


def test_the_smallest_of_equal_means_is_not_named(make):
    jobs = [make([100, 200, 300] * 4), make([200, 300, 100] * 4, strategy="argmax")]
    names = tuple(c.name for c in jobs)
    factor = Factor("strategy", "strategy", dict(zip(names, names, strict=True)),
                    dict(zip(names, names, strict=True)))  # fmt: skip
    question = Question((factor,), (Block("", names),))
    said = question_sentence(question, compare_all(jobs), {c.name: c for c in jobs})
    assert "softmax and argmax have the same mean, 200 iterations (difference 0 [" in said


def test_labels(jobs):
    labels = {"softmax": "Softmax (T = 1)", "random": "Random"}
    first, second, _ = everything(jobs, labels=labels)
    assert re.match(r"Softmax \(T = 1\) .*fastest", first)
    assert "Random never" in second


def test_every_interval_states_its_level(jobs):
    first, _ = answer(jobs, compare_all(jobs))
    assert len(re.findall(r"\d % interval", first)) == 2


def test_one_and_no_configuration(jobs):
    first, second = answer(jobs[2:], [])
    assert first.startswith("Only softmax was run: it passes in 30 of 30")
    assert second == "No differences were tested."
    assert verdicts([]) == ()
    assert answer([], [])[0].startswith("No finished configuration")


def test_nobody_passes(make):
    jobs = [make([1000] * 5), make([1000] * 5, strategy="argmax")]
    first, _ = everything(jobs)
    assert re.fullmatch("None of the 2 configurations [^.]*.", first)


def test_configurations_that_cannot_be_compared(jobs):
    first, second = answer(jobs, [])
    assert "not compared" in first
    assert re.fullmatch("No differences [^.]*tested[^.]* random never [^.]*.", second)


def test_verdicts_are_counted():
    found: list[Verdict] = ["holds", "does not hold", "open", "open", "not measured"]
    checked = [
        Checked(claim, Finding(v, "", 1200 if v == "open" else None))
        for claim, v in zip(CLAIMS, found, strict=False)
    ]
    assert verdicts(checked)[0] == (
        "Of the thesis's 5 statements, 1 holds, 1 does not hold"
        f" (“{CLAIMS[1].statement.rstrip('.')}”), 2 are open at this number of trials"
        " (settling all that have an estimate takes 1,200 trials)"
        " and 1 was not measured."
    )


def test_options_are_sorted_into_fewer_more_same_and_unclear(make, rng):
    base = np.arange(200) + 200
    cells, pairs = {}, []
    for row, other in (("a", base - 100), ("b", base + 50), ("c", base), ("d", base[::-1])):
        plain = make(base, name=f"{row}0", strategy=row)
        changed = make(other, name=f"{row}1", strategy=f"{row}+")
        cells |= {f"{row}0": (row, "none"), f"{row}1": (row, "ratio")}
        pairs.append((plain, changed))
    cells |= {"e0": ("e", "none"), "e1": ("e", "ratio")}
    pairs.append(tuple(make([1000] * 200, name=n, strategy=n) for n in ("e0", "e1")))
    (sentence,) = option_sentences(compare_pairs(pairs), cells)
    assert sentence == (
        "Ratio against none: fewer iterations under a (100); more iterations under b (50);"
        " identical trials under c; no trial passes with either under e;"
        " no significant difference under d."
    )


def test_a_plane_in_words(make, rng):
    # 40 of 40 passes: Wilson from 91 %; 0 of 40: up to 9 %; 20 of 40 is neither.
    jobs = [
        make(np.arange(40) + 200, name="ref", strategy="x"),
        make(np.arange(40) + 100, name="fast", strategy="y"),
        make([1000] * 40, name="never", strategy="z"),
        make([300] * 20 + [1000] * 20, name="half", strategy="w"),
    ]
    table = compare_pairs([(jobs[0], job) for job in jobs[1:]])
    labels = {job.name: job.name.upper() for job in jobs}
    first, second = plane_sentences(jobs, table, labels)
    assert "Of 4 points, 2 pass in more than 80 % of trials and 1 in less than 20 %" in first
    assert "FAST has the smallest mean, 120 iterations" in first
    assert second == (
        "Against REF, the thesis’s softmax, 1 of 3 points need significantly fewer iterations"
        " after Holm’s correction: FAST; 2 need significantly more."
    )
    assert len(plane_sentences(jobs, [], labels)) == 1
