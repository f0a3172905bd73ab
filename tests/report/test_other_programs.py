"""The page on runs of other programs, from the command line."""

from __future__ import annotations

import re

import numpy as np
import pytest

from trl_explore.commands.main import main


@pytest.fixture
def runs(tmp_path):
    """Long CSV files: two algorithms, eight seeds, two environments; one run cut off."""
    rng = np.random.default_rng(1)
    lines = ["algo,env,seed,step,score"]
    for env in ("Pole", "Car<b>"):
        for algo, slope in (("one", 1.0), ("two", 1.4)):
            for seed in range(8):
                end = 40 if (algo, seed) == ("two", 7) else 100
                gain = slope + rng.normal(0, 0.1)
                lines += [f"{algo},{env},{seed},{t},{gain * t}" for t in range(10, end + 1, 10)]
    (tmp_path / "runs.csv").write_text("\n".join(lines))
    return tmp_path / "runs.csv"


def report(capsys, *words):
    status = main(["report", *map(str, words)])
    out, err = capsys.readouterr()
    return status, out, err


def test_a_dry_run_shows_what_was_recognised(runs, tmp_path, capsys):
    status, out, _ = report(capsys, "--from", "csv", runs, "--dry-run")
    assert status == 0
    words = " ".join(out.split())
    assert "Pole one 8 0–7 100 Pole two 8 0–7 40 to 100" in words
    assert "Pole: judged up to step 100, smoothed over 1 point" in out
    assert not (tmp_path / "runs.csv").with_name("index.html").exists()


def test_the_page(runs, tmp_path, capsys):
    out = tmp_path / "page"
    status, shown, _ = report(capsys, "--from", "csv", runs, "--threshold", 90, "--out", out)
    assert status == 0
    assert shown.endswith(f"{out / 'index.html'}\n")
    page = (out / "index.html").read_text()
    assert "Car&lt;b&gt;" in page
    assert "<b>Car" not in page
    assert "http" not in page.replace("http://www.w3.org", "").replace("http-equiv", "")
    text = " ".join(page.split())
    assert "two has a higher final score than one" in text
    assert re.search(r"a difference of \d[\d.]* \[\d", text)  # two minus one, as it is said
    assert "7 pairs by seed" in text
    assert "Kaplan–Meier" in text
    assert "Performance profiles" in text
    assert "IQM" in text
    for name in ("runs.csv", "environment-1-configurations.tex", "environment-2-pairs-3.md"):
        assert (out / "tables" / name).stat().st_size > 100
    assert len(list((out / "figures").glob("*.svg"))) == 6


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--column", "x=y"], "--column x=y: must be ROLE=NAME, ROLE one of step, score"),
        (["--pattern", "("], "is not a regular expression"),
        (["--pattern", "a"], "has no group"),
        (["--window", "0"], "--window must be an integer >= 1, got 0"),
        (["--threshold", "x"], "--threshold x: must be SCORE or ENVIRONMENT=SCORE"),
        (["--threshold", "Boat=1"], "--threshold Boat=...: the environments are Pole, Car<b>"),
        (["--threshold", "1", "--threshold", "Pole=2"], "one for all environments, or"),
        (["--horizon", "1e9"], "no run reaches step 1,000,000,000"),
    ],
)
def test_wrong_arguments(words, message, runs, capsys):
    status, _, err = report(capsys, "--from", "csv", runs, *words)
    assert status == 1
    assert err.startswith("error: ")
    assert message in err
    assert err.count("\n") == 1


def test_each_environment_may_have_a_threshold_of_its_own(runs, tmp_path, capsys):
    """Scores reach about 100 and 140: in Pole 120 divides the two; Car has no threshold."""
    out = tmp_path / "page"
    assert report(capsys, "--from", "csv", runs, "--threshold", "Pole=120", "--out", out)[0] == 0
    text = " ".join((out / "index.html").read_text().split())
    assert "Runs that exceeded 120 by step 100: one 0 of 8, two 7 of 8." in text
    assert text.count("Runs that exceeded") == 1
    assert "Pole: &gt; 120" in text
    assert len(list((out / "figures").glob("*.svg"))) == 5


def test_one_configuration_without_seeds(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("step,return\n1,2\n2,3\n")
    status, _, _ = report(capsys, "--from", "csv", tmp_path, "--threshold", 9)
    assert status == 0
    page = (tmp_path / "report" / "index.html").read_text()
    assert "only one configuration" in page


def test_seeds_that_are_too_few_for_any_result_are_said_to_be(tmp_path, capsys):
    """With three pairs, Holm's first step needs 2 / 2^n < 0.05 / 3, which is 7 seeds."""
    lines = ["algo,seed,step,score"]
    lines += [f"{a},{s},{t},{t * (1 + k) + s}" for k, a in enumerate("xyz") for s in range(6)
              for t in (1, 2)]  # fmt: skip
    (tmp_path / "runs.csv").write_text("\n".join(lines))
    assert report(capsys, "--from", "csv", tmp_path)[0] == 0
    text = " ".join((tmp_path / "report" / "index.html").read_text().split())
    assert "with 6 pairs none, corrected for 3 comparisons, is ever significant at 5 %" in text
    assert "at least 7 seeds are needed" in text


def test_runs_of_unknown_seed_that_are_too_few_are_said_to_be(tmp_path, capsys):
    """Of 3 and 3 runs no p is below 2 / C(6, 3) = 0.1; of 4 and 4, 2 / C(8, 4) = 0.029."""
    lines = ["algo,run,step,score"]
    lines += [f"{a},{a}{r},{t},{t * (1 + 9 * k) + r}" for k, a in enumerate("xy")
              for r in range(3) for t in (1, 2)]  # fmt: skip
    (tmp_path / "runs.csv").write_text("\n".join(lines))
    assert report(capsys, "--from", "csv", tmp_path)[0] == 0
    text = " ".join((tmp_path / "report" / "index.html").read_text().split())
    assert "with 3 runs of each none is ever significant at 5 %; at least 4 runs of each" in text
    assert "says how many would be needed" not in text
    assert "at each score on its own" in text
