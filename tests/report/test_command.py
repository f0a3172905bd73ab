"""The arguments of ``trl-explore report``."""

from __future__ import annotations

import pytest

from trl_explore.commands.main import main
from trl_explore.jobs.console import Bar

SWEEP_ONLY = "configurations: [{sweep: [strategy=none]}]\n"


@pytest.fixture
def place(tmp_path, make_job, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("one", "two"):
        make_job(tmp_path / name / "train", "softmax", [150, 160])
    return tmp_path


def report(capsys, *words):
    status = main(["report", *words])
    out, err = capsys.readouterr()
    errors = [line for line in err.splitlines() if line.startswith("error: ")]
    return status, out.strip(), errors


@pytest.mark.parametrize(
    ("words", "study", "page"),
    [
        (["one", "two"], "", "one/report"),
        (["one", "--out", "page"], "", "page"),
        (["thesis.yaml", "two"], "", "two/report"),  # the file is part of the package
        (["s.yaml"], "configurations: [two, one]", "two/report"),
        (["s.yaml", "one"], "title: Mine", "one/report"),
    ],
)
def test_the_page_is_in_the_first_folder_unless_another_is_given(place, capsys, words, study, page):
    (place / "s.yaml").write_text(study)
    status, out, errors = report(capsys, *words)
    assert (status, errors) == (0, [])
    assert (place / page / "index.html").samefile(place / out)


@pytest.mark.parametrize(
    ("words", "study", "message"),
    [
        (["nothing"], "", "nothing: no such folder"),
        (["nothing.yaml"], "", "nothing.yaml: not readable as YAML: No such file"),
        (["s.yaml"], "title: Mine", "configurations=[]: a list of folders, globs or sweeps"),
        (["s.yaml"], "tytle: Mine", "tytle='Mine': the keys are title, question"),
        (["s.yaml", "s.yaml"], "", "s.yaml: one study at a time"),
        (["s.yaml", "--from", "csv"], SWEEP_ONLY, "a study has no runs of other programs"),
        (["one", "--threshold", "3"], "", "--threshold: only with --from"),
        (["one", "--dry-run"], "", "--dry-run: only with --from"),
        (["."], "", "no finished job (run.json) at or below it"),
    ],
)
def test_a_wrong_argument_is_one_line(tmp_path, monkeypatch, capsys, words, study, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one").mkdir()
    (tmp_path / "s.yaml").write_text(study)
    status, out, errors = report(capsys, *words)
    assert (status, out, len(errors)) == (1, "", 1)
    assert message in errors[0]
    assert not list(tmp_path.rglob("index.html"))


def test_the_progress_is_a_bar_on_a_terminal_and_lines_elsewhere(place, capsys, monkeypatch):
    assert main(["report", "one", "two"]) == 0
    stages = capsys.readouterr().err.splitlines()
    assert (stages[0], stages[-1]) == ("reading 2 jobs", "page")

    shown = []
    monkeypatch.setattr(Bar, "__init__", lambda self, label: setattr(self, "live", True))
    monkeypatch.setattr(Bar, "show", lambda self, *told: shown.append(told))
    monkeypatch.setattr(Bar, "close", lambda self: shown.append("closed"))
    assert main(["report", "one", "two"]) == 0
    *told, last = shown
    assert ([stage for _, _, stage in told], last) == (stages, "closed")
    done = [share for share, _, _ in told]
    assert done == sorted(done)
    assert 0 <= done[0] < done[-1] < 1
    assert capsys.readouterr().err == ""
