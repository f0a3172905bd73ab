"""How often ``settle`` errs, and how many trials it saves: simulated, with known truth.

    python benchmarks/sequential.py [--samples 1000] [--cores 2]

Five configurations, or two, whose times are log-normal with a share of failures, at a cap of 1,000;
20 to 500 trials of each. Times are independent, or correlated in the pairs. For a real effect, the
times of one configuration are multiplied by a factor. The fixed design compares all pairs after 500
trials with Holm's correction.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trl_explore.statistics.means import mean_difference
from trl_explore.statistics.samples import Sample
from trl_explore.statistics.sequential import planned_looks, settle

CAP = 1000.0


class Case(NamedTuple):
    """A population: what differs between its configurations, and how times are drawn."""

    name: str
    factors: tuple[float, ...] = (1.0,) * 5
    failing: float = 0.03
    sigma: float = 0.6
    shared: float = 0.0


class Found(NamedTuple):
    """What one simulated experiment found."""

    wrong: bool
    right: float
    used: float
    fixed_wrong: bool
    fixed_right: float


CASES = (
    Case("equal, 3 % fail"),
    Case("equal, none fails", failing=0.0),
    Case("equal, 20 % fail", failing=0.2),
    Case("equal, skewed (σ = 1.2)", sigma=1.2),
    Case("equal, correlated pairs", shared=0.7),
    Case("one 50 % slower", (1.5, 1.0, 1.0, 1.0, 1.0)),
    Case("one twice as slow", (2.0, 1.0, 1.0, 1.0, 1.0)),
    Case("all differ", (1.0, 1.3, 1.7, 2.2, 2.9)),
    Case("two, one 30 % slower", (1.3, 1.0)),
    Case("two, one 50 % slower", (1.5, 1.0)),
    Case("two, one twice as slow", (2.0, 1.0)),
)


def draw(case: Case, n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Times [configurations, n], restricted to the cap; a failed trial has the cap."""
    common, own = rng.normal(size=n), rng.normal(size=(len(case.factors), n))
    z = np.sqrt(case.shared) * common + np.sqrt(1.0 - case.shared) * own
    times = 150.0 * np.asarray(case.factors)[:, None] * np.exp(case.sigma * z)
    return np.minimum(np.where(rng.random(times.shape) < case.failing, CAP, times), CAP)


def simulate(case: Case, looks: Sequence[int], seed: int) -> Found:
    """One experiment."""
    times = draw(case, looks[-1], np.random.default_rng([seed, CASES.index(case)]))
    names = [str(i) for i in range(len(times))]
    used = dict.fromkeys(names, 0)

    def more(wanted: Sequence[str], n: int) -> dict[str, Sample]:
        used.update(dict.fromkeys(wanted, n))
        return {i: _sample(times[int(i), :n]) for i in wanted}

    pairs = list(combinations(names, 2))
    true = {(a, b): case.factors[int(a)] - case.factors[int(b)] for a, b in pairs}
    found = {(v.a, v.b): v.result for v in settle(pairs, more, looks)}
    results = {p: 0 if r == "open" else 1 if r == p[0] else -1 for p, r in found.items()}
    samples = {i: _sample(times[int(i)]) for i in names}
    tests = {p: mean_difference(samples[p[0]], samples[p[1]]) for p in pairs}
    fixed = {}
    for rank, p in enumerate(sorted(pairs, key=lambda p: tests[p].p_value)):
        stopped = rank and not list(fixed.values())[-1]
        significant = not stopped and tests[p].p_value <= 0.05 / (len(pairs) - rank)
        fixed[p] = int(np.sign(tests[p].estimate.value)) if significant else 0
    real = [p for p in pairs if true[p]]
    share = [
        float(np.mean([f[p] == np.sign(true[p]) for p in real])) if real else np.nan
        for f in (results, fixed)
    ]
    wrong = [any(r and r != np.sign(true[p]) for p, r in f.items()) for f in (results, fixed)]
    return Found(wrong[0], share[0], sum(used.values()) / (len(names) * looks[-1]),
                 wrong[1], share[1])  # fmt: skip


def _sample(times: NDArray[np.float64]) -> Sample:
    return Sample.of(times, times >= CAP, least=CAP, most=CAP)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Simulate settle.")
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--cores", type=int, default=2)
    arguments = parser.parse_args()
    looks = planned_looks(20, 500)
    print(f"{arguments.samples} samples; looks after {', '.join(map(str, looks))} trials\n")
    print(
        "| configurations | wrong, % | wrong, fixed, % | found, % | found, fixed, % | trials, % |"
    )
    print("|---|---:|---:|---:|---:|---:|")
    with ProcessPoolExecutor(arguments.cores) as pool:
        for case in CASES:
            run = partial(simulate, case, looks)
            found = list(pool.map(run, range(arguments.samples), chunksize=10))
            mean = np.mean(np.array(found, dtype=np.float64), axis=0)
            wrong, right, used, fixed_wrong, fixed_right = (f"{100 * x:.1f}" for x in mean)
            cells = [case.name, wrong, fixed_wrong, right, fixed_right, used]
            print(f"| {' | '.join(cells).replace('nan', '')} |", flush=True)


if __name__ == "__main__":
    main()
