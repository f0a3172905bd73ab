"""Sentences about options and planes."""

import re

import numpy as np

from trl_explore.statistics.comparisons import compare_pairs
from trl_explore.statistics.effects import option_sentences, plane_sentences


def test_options_are_sorted_into_fewer_more_same_and_unclear(make, rng):
    base = np.arange(20) + 200
    cells, pairs = {}, []
    for row, other in (("a", base - 100), ("b", base + 50), ("c", base), ("d", base[::-1])):
        plain = make(base, name=f"{row}0", strategy=row)
        changed = make(other, name=f"{row}1", strategy=f"{row}+")
        cells |= {f"{row}0": (row, "none"), f"{row}1": (row, "ratio")}
        pairs.append((plain, changed))
    cells |= {"e0": ("e", "none"), "e1": ("e", "ratio")}
    pairs.append(tuple(make([1000] * 20, name=n, strategy=n) for n in ("e0", "e1")))
    (sentence,) = option_sentences(compare_pairs(pairs, rng, resamples=999), cells)
    assert sentence == (
        "Ratio against none: fewer iterations under a (100); more iterations under b (50);"
        " the very same trials under c; no trial passes with either under e;"
        " no difference beyond chance under d."
    )


def test_only_planned_pairs_are_corrected_for(make, rng):
    base = np.arange(20) + 200
    jobs = [make(base + 9 * k, name=f"s{k}", strategy=f"s{k}") for k in range(3)]
    (alone,) = compare_pairs([(jobs[0], jobs[1])], rng, resamples=199)
    assert alone.p_holm == alone.p_value
    two = compare_pairs([(jobs[0], jobs[1]), (jobs[0], jobs[2])], rng, resamples=199)
    # Both p-values are the smallest possible one, so that Holm doubles each.
    assert [round(c.p_holm / c.p_value, 6) for c in two] == [2.0, 2.0]


def test_a_plane_in_words(make, rng):
    # 40 of 40 passes: Wilson from 91 %; 0 of 40: up to 9 %; 20 of 40 is neither.
    jobs = [
        make(np.arange(40) + 200, name="ref", strategy="x"),
        make(np.arange(40) + 100, name="fast", strategy="y"),
        make([1000] * 40, name="never", strategy="z"),
        make([300] * 20 + [1000] * 20, name="half", strategy="w"),
    ]
    table = compare_pairs([(jobs[0], job) for job in jobs[1:]], rng, resamples=999)
    labels = {job.name: job.name.upper() for job in jobs}
    first, second = plane_sentences(jobs, table, labels, 0.95)
    assert re.search("4 points.* 2 .*80 % .* 1 .*20 %", first)
    assert re.search("120 iterations.* FAST", first)
    assert re.search("REF.* 1 of 3 points .*fewer .*Holm.* FAST.* 2 .*more", second)
    assert len(plane_sentences(jobs, [], labels, 0.95)) == 1
