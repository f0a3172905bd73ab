"""The same seed gives the same run: as when it was written down, and however it is run."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from trl_explore.strategies import EpsilonGreedy, Softmax

sys.path.insert(0, str(Path(__file__).parent))
from golden.runs import COLLECTORS, RUN, STRATEGIES, golden, summary


def first_difference(one, two) -> str | None:
    """Where two runs part, and how far apart their weights are by then; None: nowhere."""
    a, b = one.trials.episodes(), two.trials.episodes()
    for place in range(min(len(a["score"]), len(b["score"]))):
        rows = [
            tuple(column[place] for column in (e["iteration"], e["trial"], e["score"], e["frames"]))
            for e in (a, b)
        ]
        if rows[0] != rows[1]:
            iteration, trial, *_ = rows[0]
            apart = max(
                float((p - q).detach().abs().max())
                for p, q in zip(one.optimizer.parameters, two.optimizer.parameters, strict=True)
            )
            return (
                f"they part in iteration {iteration}, trial {trial}: score and frames "
                f"{rows[0][2:]} and {rows[1][2:]}; the final weights differ by {apart:.2g}. "
                "About 1e-6 before is rounding that has turned an action; more is an error"
            )
    if len(a["score"]) != len(b["score"]):
        return f"{len(a['score'])} episodes and {len(b['score'])}"
    return None


@pytest.mark.parametrize("collector", COLLECTORS)
@pytest.mark.parametrize("name", STRATEGIES)
def test_the_golden_run(name, collector, train):
    run = RUN
    found = summary(train(STRATEGIES[name](), 5, collector=COLLECTORS[collector], **run))
    expected = golden()[name]
    assert found["first"] == expected["first"]
    assert found["sha256"] == expected["sha256"]
    np.testing.assert_allclose(found["weight"], expected["weight"], rtol=1e-4)


@pytest.mark.parametrize("name", STRATEGIES)
def test_both_collectors_train_alike(name, train):
    run = {**RUN, "seed": 11, "max_iterations": 12}
    one, two = (train(STRATEGIES[name](), 4, collector=c, **run) for c in COLLECTORS.values())
    difference = first_difference(one, two)
    assert difference is None, difference
    for p, q in zip(one.optimizer.parameters, two.optimizer.parameters, strict=True):
        np.testing.assert_allclose(p.detach(), q.detach(), rtol=1e-4, atol=1e-5)


def test_the_first_difference_is_found(train):
    one, two = (train(Softmax(), 3, seed=seed, max_iterations=4) for seed in (0, 1))
    difference = first_difference(one, two)
    assert difference is not None
    assert difference.startswith("they part in iteration 1, trial ")


@pytest.mark.parametrize("collector", COLLECTORS)
def test_trial_7_alone_is_trial_7_of_30(collector, train):
    run = partial(train, collector=COLLECTORS[collector], seed=3, max_iterations=10)
    many = run(EpsilonGreedy(0.3), 30, score_window=3, score_threshold=25.0)
    one = run(EpsilonGreedy(0.3), 1, first_trial=7, score_window=3, score_threshold=25.0)
    for p, q in zip(one.optimizer.parameters, many.optimizer.parameters, strict=True):
        assert p.detach()[0].numpy().tobytes() == q.detach()[7].numpy().tobytes()
    a, b = one.trials.episodes(), many.trials.episodes()
    for name in ("iteration", "score", "frames"):
        assert a[name].tolist() == b[name][b["trial"] == 7].tolist()
