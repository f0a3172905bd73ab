"""The study of the thesis as one command."""

from __future__ import annotations

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from trl_explore.commands import thesis


@pytest.fixture
def run(monkeypatch):
    def run(statuses):
        done = []
        left = iter(statuses)
        monkeypatch.setattr(thesis.commands, "main", lambda words: done.append(words) or next(left))
        return thesis.main(), done

    return run


@pytest.mark.parametrize("name", ["it's", r"back\slash", r"a\'b", "tail\\", "a b", "x${y}", "ü"])
def test_every_step_works_on_the_folders_of_the_same_study(run, monkeypatch, tmp_path, name):
    monkeypatch.setattr("sys.argv", ["trl-explore thesis", "--out", str(tmp_path / name)])
    status, steps = run([0] * 6)
    assert status == 0
    trained = set()
    for _, experiment, output in steps[:3]:
        place = OverridesParser.create().parse_override(output)
        assert place.key_or_group == "output_dir"
        trained.add(f"{place.value()}/{experiment.partition('=')[2]}")
    assert {step[1] for step in steps[3:5]} < trained
    assert set(steps[5][2:5]) == trained
    assert steps[5][5:] == ["--out", str(tmp_path / name / "report")]


def test_a_step_that_fails_is_the_last_one(run, monkeypatch):
    monkeypatch.setattr("sys.argv", ["trl-explore thesis"])
    status, steps = run([0, 3])
    assert (status, len(steps)) == (3, 2)


def test_each_folder_of_a_study_has_its_experiment():
    from trl_explore.config import CONF

    names = {words[1].removeprefix("experiment=") for words in thesis.STEPS[:3]}
    assert all((CONF / "experiment" / f"{name}.yaml").is_file() for name in names)
