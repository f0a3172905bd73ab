"""The maps of where the trials have been."""

from __future__ import annotations

import numpy as np
import pytest
from safetensors.numpy import save_file

from trl_explore.report import evidence
from trl_explore.report.figures.maps import visits
from trl_explore.report.loading import load
from trl_explore.report.style import visual_language


@pytest.fixture
def job(tmp_path, make_job):
    return make_job(tmp_path / "deep_sea", "softmax", [100, 120], env="FrozenLake-v1")


def write_visits(job):
    """The visits of a task with two rows and three columns, at six iterations."""
    iteration = np.array([1, 2, 4, 8, 16, 20])
    visits = np.zeros((6, 2, 3), dtype=np.int64)
    visits[:, 0, 0] = 10 * iteration
    visits[3:, 1, 2] = 30
    arrays = {"iteration": iteration, "visits": visits, "reached": (visits > 0) * 2}
    save_file(arrays, job / "visits.safetensors")


def found(job):
    return evidence.gather(load([job]))


def test_a_map_per_iteration(job):
    write_visits(job)
    (group,) = found(job).groups
    assert visits.applies(group)
    with visual_language():
        figure = visits.draw(group)[0]
    maps = [ax for ax in figure.axes if ax.images]
    assert [ax.get_title() for ax in maps] == ["iteration 1", "4", "8", "20"]
    last = maps[-1].images[0].get_array()
    assert last is not None
    share = np.ma.filled(np.ma.masked_invalid(last), 0)
    np.testing.assert_allclose(share, [[200 / 230, 0, 0], [0, 0, 30 / 230]])
    assert "softmax: 2 of 6" in visits.draw(group)[1]


@pytest.mark.parametrize("data", [b"", b"no tensors at all", None])
def test_an_unreadable_file_is_a_gap(job, data):
    if data is None:
        save_file({"iteration": np.arange(2)}, job / "visits.safetensors")
    else:
        (job / "visits.safetensors").write_bytes(data)
    everything = found(job)
    assert not visits.applies(everything.groups[0])
    assert any("visits.safetensors" in gap.why for gap in everything.gaps)


def test_without_the_file_there_is_no_figure(job):
    assert not visits.applies(found(job).groups[0])


def test_one_of_two_configurations_was_not_recorded(job, make_job):
    write_visits(job)
    make_job(job.parent, "argmax", [100, 120], env="FrozenLake-v1", strategy="argmax")
    (group,) = evidence.gather(load([job.parent])).groups
    assert visits.applies(group)
    with visual_language():
        caption = visits.draw(group)[1]
    assert "softmax: 2 of 6" in caption
    assert "argmax: not recorded" in caption
