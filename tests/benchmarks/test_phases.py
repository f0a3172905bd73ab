"""Where the time of an iteration goes is measured from outside, by the names of the parts."""

import importlib
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def phases(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("phases")


def test_every_part_takes_time_and_all_of_them_the_whole(phases):
    parts = phases.phases(trials=3, max_iterations=2)
    assert list(parts) == [*phases.PHASES, "rest", "total"]
    total = parts.pop("total")
    assert all(part > 0 for part in parts.values())
    assert sum(parts.values()) == pytest.approx(total)


def test_a_part_of_another_name_is_noticed(phases, monkeypatch):
    monkeypatch.delattr("trl_explore.training.trials.Trials.record")
    with pytest.raises(AttributeError, match="record"):
        phases.phases(trials=1, max_iterations=1)


def test_the_parts_are_put_back(phases):
    trainer = phases.build("softmax", 1, max_iterations=1)
    before = dict(vars(trainer)), dict(vars(trainer.loss))
    with phases.wrapped(trainer, phases.Clock()):
        assert "_diverged" in vars(trainer)
    assert (dict(vars(trainer)), dict(vars(trainer.loss))) == before
