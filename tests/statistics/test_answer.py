import re

import numpy as np
import pytest

from trl_explore.statistics.answer import answer, because
from trl_explore.statistics.comparisons import compare_all
from trl_explore.thesis import CLAIMS, Checked, Finding, Study, Verdict, check_claims, why


@pytest.fixture
def jobs(make, rng):
    return [
        make([1000] * 30, strategy="random"),
        make(rng.integers(300, 600, size=30), strategy="epsilon_greedy"),
        make(rng.integers(100, 200, size=30), strategy="softmax"),
    ]


def everything(jobs, **options):
    rng = np.random.default_rng(0)
    comparisons = compare_all(jobs, rng, resamples=999)
    checked = check_claims(Study(jobs, resamples=999), rng)
    return answer(jobs, comparisons, checked, **options)


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


def test_labels(jobs):
    labels = {"softmax": "Softmax (T = 1)", "random": "Random"}
    first, second, _ = everything(jobs, labels=labels)
    assert re.match(r"Softmax \(T = 1\) .*fastest", first)
    assert "Random never" in second


def test_one_and_no_configuration(jobs):
    first, second, third = answer(jobs[2:], [], [])
    assert re.match("Only softmax .*30 of 30", first)
    assert re.fullmatch("No differences [^.]*tested.", second)
    assert re.fullmatch("None [^.]*statements [^.]*.", third)
    assert re.match("No .*configuration", answer([], [], [])[0])


def test_nobody_passes(make):
    jobs = [make([1000] * 5), make([1000] * 5, strategy="argmax")]
    first, second, _ = everything(jobs)
    assert re.fullmatch("None of the 2 configurations [^.]*.", first)
    assert "softmax and argmax never" in second


def test_configurations_that_cannot_be_compared(jobs):
    first, second, _ = answer(jobs, [], [])
    assert "not compared" in first
    assert re.fullmatch("No differences [^.]*tested[^.]* random never [^.]*.", second)


def test_verdicts_are_counted():
    verdicts: list[Verdict] = ["holds", "does not hold", "open", "open", "not measured"]
    checked = [
        Checked(claim, Finding(v, "", 1200 if v == "open" else None))
        for claim, v in zip(CLAIMS, verdicts, strict=False)
    ]
    third = answer([], [], checked)[2]
    failed = re.escape(CLAIMS[1].statement.rstrip("."))
    assert re.search(
        f" 5 statements 1 holds, 1 does not hold .“{failed}”.*, 2 .*open .*1,200 .* 1 .*measured",
        third,
    )


def test_what_the_bias_explains_is_said_with_its_verdict():
    first, second, third = (Checked(claim, Finding(v, "")) for claim, v in zip(
        why.CLAIMS, ("holds", "open", "not measured"), strict=False
    ))  # fmt: skip
    text = because([first, second, third])
    statements = [re.escape(claim.statement.rstrip(".")) for claim in why.CLAIMS]
    assert re.search(f"“{statements[0]}”[^“]* holds.*“{statements[1]}”[^“]* open", text)
    assert statements[2] not in text
    assert because([third]) == because([]) == ""


def test_the_statements_on_the_bias_are_among_those_that_are_checked():
    assert set(why.BIAS) < {claim.id for claim in why.CLAIMS}
