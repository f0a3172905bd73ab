from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from trl_explore.statistics.means import mean_difference
from trl_explore.statistics.samples import Sample
from trl_explore.statistics.sequential import planned_looks, settle, spending


def experiment(times, looks, **more):
    """Verdicts and used trials, of times [configurations, n] with a cap of 1000."""
    used = {}

    def draw(names, n):
        used.update(dict.fromkeys(names, n))
        x = {name: times[int(name), :n] for name in names}
        return {k: Sample.of(v, v >= 1000, least=1000, most=1000) for k, v in x.items()}

    pairs = list(combinations(map(str, range(len(times))), 2))
    return settle(pairs, draw, looks, **more), used


def times(factors, n, seed, failing=0.05):
    rng = np.random.default_rng(seed)
    drawn = 150 * np.asarray(factors)[:, None] * np.exp(0.8 * rng.normal(size=(len(factors), n)))
    return np.minimum(np.where(rng.random(drawn.shape) < failing, 1000, drawn), 1000)


def test_the_looks_and_their_errors():
    looks = planned_looks(20, 500)
    assert looks == [20, 30, 45, 67, 100, 150, 225, 337, 500]
    assert sum(spending(looks)) == pytest.approx(0.05)
    assert spending([10, 40], level=0.9) == pytest.approx([0.025, 0.075])
    assert planned_looks(7, 7) == [7]
    for first, most in ((1, 5), (6, 5)):
        with pytest.raises(ValueError, match="2 ≤ first ≤ most"):
            planned_looks(first, most)


def test_decided_pairs_get_no_more_trials_and_open_ones_get_all():
    verdicts, used = experiment(times([1, 1, 4], 200, 0), [20, 50, 200])
    by_pair = {(v.a, v.b): v for v in verdicts}
    assert by_pair["0", "1"].result == "open"
    assert by_pair["0", "1"].trials == 200
    for pair in (("0", "2"), ("1", "2")):
        assert by_pair[pair].result == "2"  # the greater mean
        assert by_pair[pair].difference.high < 0
    assert used["2"] == max(by_pair["0", "2"].trials, by_pair["1", "2"].trials) < 200
    assert used["0"] == used["1"] == 200


def test_each_look_is_holms_procedure_at_its_share_of_the_error():
    x = times([1, 1.3, 1.9], 60, 3)
    verdicts, _ = experiment(x, [60])
    samples = [Sample.of(row, row >= 1000, least=1000, most=1000) for row in x]
    p = [mean_difference(samples[int(v.a)], samples[int(v.b)]).p_value for v in verdicts]
    order, rejected = np.argsort(p), []
    for rank, i in enumerate(order):
        if p[i] > 0.05 / (3 - rank):
            break
        rejected.append(i)
    assert 0 < len(rejected) < 3
    assert [v.result != "open" for v in verdicts] == [i in rejected for i in range(3)]


def test_a_margin_settles_equality():
    x = times([1, 1, 6], 3000, 1, failing=0.0)
    verdicts, used = experiment(x, planned_looks(30, 3000), margin=60.0)
    assert [v.result for v in verdicts] == ["equal", "2", "2"]
    assert -60 <= verdicts[0].difference.low < 0 < verdicts[0].difference.high <= 60
    assert max(used.values()) < 3000


def test_the_family_wise_error_is_held_and_trials_are_saved():
    """benchmarks/sequential.py simulates more of both."""
    looks, samples = planned_looks(15, 75), 120
    wrong = sum(
        any(v.result != "open" for v in experiment(times([1, 1, 1, 1], 75, seed), looks)[0])
        for seed in range(samples)
    )
    assert wrong <= 12  # of 120 at 5 %: P(more than 12) = 0.6 %
    found = [experiment(times([3, 1], 75, seed), looks) for seed in range(samples // 4)]
    assert np.mean([verdicts[0].result == "0" for verdicts, _ in found]) > 0.9
    assert np.mean([used["0"] / 75 for _, used in found]) < 0.7
