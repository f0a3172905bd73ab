import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from trl_explore.statistics import bootstrap as module
from trl_explore.statistics.bootstrap import bootstrap, streams


def mean(x):
    return x.mean(axis=-1)


def interval(drawn):
    # 9999 resamples: 2.5 % of 9998 intervals between them, rounded outwards.
    return np.sort(drawn)[[249, 9749]].tolist()


def test_interval_is_that_of_plain_index_draws(rng):
    """The draws are pinned, so that no version of SciPy changes published numbers unseen."""
    x, y, z = (rng.exponential(100.0, size=n) for n in (60, 60, 25))

    def index(g, n):
        return g.integers(n, size=(9999, n))

    g = np.random.default_rng(1)
    e = bootstrap(mean, [x], np.random.default_rng(1))
    assert [e.low, e.high] == interval(mean(x[index(g, 60)]))
    assert e.value == x.mean()
    g = np.random.default_rng(2)
    e = bootstrap(lambda a, b: mean(a) - mean(b), [x, z], np.random.default_rng(2))
    assert [e.low, e.high] == interval(mean(x[index(g, 60)]) - mean(z[index(g, 25)]))
    g = np.random.default_rng(3)
    e = bootstrap(lambda a, b: mean(a) / mean(b), [x, y], np.random.default_rng(3), paired=True)
    pairs = index(g, 60)
    assert [e.low, e.high] == interval(mean(x[pairs]) / mean(y[pairs]))


def test_paired_draws_keep_pairs_together(rng):
    x = rng.normal(size=30)
    e = bootstrap(lambda a, b: mean(a - b), [x, x + 1.0], rng, paired=True)
    assert (e.low, e.high) == pytest.approx((-1.0, -1.0))
    loose = bootstrap(lambda a, b: mean(a) - mean(b), [x, x + 1.0], rng)
    assert loose.high - loose.low > 0.5


def test_coverage_is_near_the_level(rng):
    hits = 0
    for _ in range(400):
        e = bootstrap(mean, [rng.normal(size=50)], rng, resamples=400, level=0.9)
        hits += e.low <= 0.0 <= e.high
    assert hits / 400 == pytest.approx(0.9, abs=0.05)


def test_level_widens_the_interval(rng):
    x = rng.normal(size=40)
    widths = [
        e.high - e.low
        for e in (bootstrap(mean, [x], np.random.default_rng(0), level=v) for v in (0.5, 0.9, 0.99))
    ]
    assert widths == sorted(widths)
    # 0.99 / 0.5 quantiles of a normal: 2.576 / 0.674
    assert widths[2] / widths[0] == pytest.approx(3.82, rel=0.1)


def test_infinite_resamples_stay_infinite(rng):
    e = bootstrap(lambda x: np.where(x.sum(-1) == 0, np.inf, x.sum(-1)), [[0, 0, 0, 1]], rng)
    assert e.high == np.inf
    assert e.low == 1.0


def test_undefined_resamples_give_no_interval(rng):
    e = bootstrap(lambda x: np.where(x.sum(-1) == 0, np.nan, x.sum(-1)), [[0, 0, 0, 1]], rng)
    assert np.isnan([e.low, e.high]).all()


def test_one_trial_and_no_variance(rng):
    one = bootstrap(mean, [[5.0]], rng)
    assert one.value == 5.0
    assert np.isnan([one.low, one.high]).all()
    same = bootstrap(mean, [[5.0, 5.0]], rng)
    assert (same.low, same.value, same.high) == (5.0, 5.0, 5.0)


def test_same_generator_same_interval():
    x = np.sqrt(np.arange(20.0))
    assert bootstrap(mean, [x], np.random.default_rng(3)) == bootstrap(
        mean, [x], np.random.default_rng(3)
    )
    assert bootstrap(mean, [x], np.random.default_rng(3)) != bootstrap(
        mean, [x], np.random.default_rng(4)
    )


def test_batches_cover_all_resamples(rng, monkeypatch):
    monkeypatch.setattr(module, "BATCH", 70)
    sizes = []

    def count(x):
        sizes.append(x.shape[0] if x.ndim > 1 else 0)
        return mean(x)

    bootstrap(count, [np.arange(10.0)], rng, resamples=23)
    assert sizes == [0, 7, 7, 7, 2]


@settings(max_examples=30, deadline=None)
@given(arrays(np.float64, st.integers(2, 20), elements=st.floats(-100, 100)), st.floats(-50, 50))
def test_interval_moves_with_the_data(x, shift):
    a = bootstrap(mean, [x], np.random.default_rng(0), resamples=99)
    b = bootstrap(mean, [x + shift], np.random.default_rng(0), resamples=99)
    assert (b.low - a.low, b.high - a.high) == pytest.approx((shift, shift), abs=1e-9)
    assert x.min() - 1e-9 <= a.low <= a.high <= x.max() + 1e-9


@pytest.mark.parametrize(
    ("samples", "options", "message"),
    [
        ([], {}, r"\[\] trials"),
        ([[]], {}, r"\[0\] trials"),
        ([[1.0], [1.0, 2.0]], {"paired": True}, r"\[1, 2\] trials"),
        ([[1.0, 2.0]], {"resamples": 0}, "resamples=0"),
        ([[1.0, 2.0]], {"level": 95}, "level=95"),
    ],
)
def test_refuses(samples, options, message, rng):
    with pytest.raises(ValueError, match=message):
        bootstrap(mean, samples, rng, **options)


def test_streams_depend_on_seed_and_label_only():
    first = {k: g.random() for k, g in streams(np.random.default_rng(1), ["a", "b"]).items()}
    again = {k: g.random() for k, g in streams(np.random.default_rng(1), ["b", "c", "a"]).items()}
    other = {k: g.random() for k, g in streams(np.random.default_rng(2), ["a", "b"]).items()}
    assert first["a"] == again["a"]
    assert first["b"] == again["b"]
    assert len({*first.values(), *other.values(), again["c"]}) == 5
