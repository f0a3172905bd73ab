"""The page on tuned strategies."""

from __future__ import annotations

import numpy as np
import pytest

from trl_explore.report.tuning import Tuned, build_page, warnings
from trl_explore.statistics.comparisons import ITERATIONS
from trl_explore.statistics.outcomes import Outcomes


def outcomes(strategy, mean, seed, n):
    steps = np.round(mean + np.random.default_rng([n, int(mean)]).normal(0, 3, n)).astype(int)
    return Outcomes(
        name=f"{strategy}-{mean}", experiment="", strategy=strategy, parameters={"mean": mean},
        config={"stop_on": "training"}, cap=200, threshold=0.0, window=10, trial=np.arange(n),
        seed=np.full(n, seed), iterations=steps, converged=np.ones(n, bool), score=np.ones(n),
        frames=steps, seconds=np.ones(n), status=np.full(n, "converged"),
    )  # fmt: skip


@pytest.fixture
def tuned():
    grid = {(lr, t): 60 + 40 * abs(np.log10(lr) + 1) + 20 * abs(t - 1)
            for lr in (0.01, 0.1, 1.0) for t in (0.5, 1.0, 2.0)}  # fmt: skip
    tried = [({"lr": lr, "t": t}, outcomes("softmax", m, 0, 9)) for (lr, t), m in grid.items()]
    few = [({"lr": lr}, outcomes("argmax", m, 0, 9)) for lr, m in ((0.01, 150), (0.1, 120))]
    return [
        Tuned("softmax", tried, list(grid).index((0.1, 1.0)), outcomes("softmax", 62, 1, 30)),
        Tuned("argmax", few, 1, outcomes("argmax", 121, 1, 30)),
    ]


def test_a_slice_varies_one_parameter_and_holds_the_others_at_their_best(tuned):
    assert [(x, o.name) for x, o in tuned[0].slice("lr")] == [
        (0.01, "softmax-100.0"), (0.1, "softmax-60.0"), (1.0, "softmax-100.0"),
    ]  # fmt: skip
    assert [x for x, _ in tuned[0].slice("t")] == [0.5, 1.0, 2.0]
    assert tuned[1].slice("t") == []


def test_warnings(tuned):
    fair = " ".join(warnings(tuned, 0, 1))
    assert "best lr of argmax is at the edge" in fair
    assert "of softmax" not in fair
    assert "have 2 to 9 settings" in fair
    assert "picked on the seeds that judge them" not in fair
    assert "picked on the seeds that judge them" in warnings(tuned, 1, 1)[0]


def test_the_page(tuned, tmp_path):
    page = build_page(tuned, ITERATIONS, tmp_path, tuning=0, judging=1).read_text()
    text = " ".join(page.split())
    assert "softmax takes fewer iterations than argmax" in text
    assert "Sensitivity to lr" in text
    assert "Sensitivity to t" in text
    assert len(list((tmp_path / "figures").glob("*.svg"))) == 2
    assert (tmp_path / "tables" / "tuned.tex").stat().st_size > 100
    assert len((tmp_path / "tables" / "tried.csv").read_text().splitlines()) == 12
