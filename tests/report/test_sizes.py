"""Configurations that differ in the size of the task: their layout, pairs and figure."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from trl_explore.report import evidence, layouts
from trl_explore.report.figures.by_parameter import first_reward
from trl_explore.report.figures.differences import forest
from trl_explore.report.figures.survival import curves
from trl_explore.report.loading import load
from trl_explore.report.style import visual_language

CAP = 500
DURATIONS = {  # strategy -> size -> episodes to the first reward of five trials
    "random": {4: [8, 12, 20, 5, 11], 8: [200, 150, CAP, CAP, 90], 12: [CAP] * 5},
    "softmax": {4: [10, 10, 10, 10, 10], 8: [40, 50, 60, 70, 80], 12: [CAP, 300, 100, 200, CAP]},
}


def write_sizes(folder, make_job):
    """Two strategies at three sizes, each with and without an intrinsic reward."""
    for strategy, by_size in DURATIONS.items():
        for size, durations in by_size.items():
            for reward in (0.0, 1.0):
                job = make_job(
                    folder / "deep_sea", f"{strategy},{size},{reward}", durations, cap=CAP,
                    strategy=strategy, env="trl_explore/DeepSea-v0", threshold=0.0,
                )  # fmt: skip
                run = json.loads((job / "run.json").read_text())
                run["config"] |= {"score_window": 1, "intrinsic_reward": reward}
                run["config"]["env"] |= {"kwargs": {"size": size}, "max_steps": size}
                (job / "run.json").write_text(json.dumps(run))
    (found,) = evidence.gather(load([folder / "deep_sea"])).groups
    return found


@pytest.fixture
def swept(tmp_path, make_job):
    return write_sizes(tmp_path, make_job)


def test_the_layout(swept):
    layout = layouts.lines_by_size(swept.group.configurations)
    assert list(layout) == ["intrinsic reward = 0", "intrinsic reward = 1"]
    for panel in layout.values():
        assert list(panel) == ["random", "softmax"]
        assert [list(line) for line in panel.values()] == [[4, 8, 12]] * 2


def test_strategies_are_compared_at_the_same_size(swept):
    pairs = [(c.a, c.b) for c in swept.comparisons]
    assert sorted(pairs) == sorted(
        (f"random,{size},{reward}", f"softmax,{size},{reward}")
        for size in (4, 8, 12)
        for reward in (0.0, 1.0)
    )
    assert swept.sentences[0] == (
        "Passed at size 12: intrinsic reward = 0: random 0 of 5, softmax 3 of 5; "
        "intrinsic reward = 1: random 0 of 5, softmax 3 of 5."
    )


def test_the_figure(swept):
    assert first_reward.applies(swept)
    assert not curves.applies(swept)
    assert not forest.applies(swept)
    with visual_language():
        figure = first_reward.draw(swept)[0]
    left, right = (ax for ax in figure.axes if ax.get_title(loc="left"))
    assert left.get_yscale() == "log"
    assert right.get_title(loc="left") == "intrinsic reward = 1"
    lines = [np.asarray(line.get_xydata()) for line in left.get_lines()]
    known_random, over_random, known_softmax, over_softmax, cap, uniform = lines
    assert known_random.tolist() == [[4, 11], [8, 200]]  # the medians of five
    assert known_softmax.tolist() == [[4, 10], [8, 60], [12, 300]]
    assert over_random[:, 0].tolist() == [12]
    assert over_random[0, 1] > CAP
    assert len(over_softmax) == 0
    assert set(cap[:, 1]) == {CAP}
    np.testing.assert_allclose(uniform[:, 1], math.log(2) * 2 ** uniform[:, 0])
    assert uniform[-1, 1] == pytest.approx(CAP)
    caption = first_reward.draw(swept)[1]
    assert "episodes to the first score above 0" in caption
    assert "softmax 3 of 5" in caption


def test_jobs_of_one_size_have_no_such_figure(tmp_path, make_job):
    for strategy in ("random", "softmax"):
        make_job(tmp_path / "thesis", strategy, [100, 200, 300], strategy=strategy)
    (found,) = evidence.gather(load([tmp_path])).groups
    assert not found.group.sized
    assert not first_reward.applies(found)
