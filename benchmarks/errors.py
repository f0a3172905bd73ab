"""How often the intervals cover and the verdicts err: large runs, resampled.

    python benchmarks/errors.py FOLDER [--repetitions 400] [--only coverage claims]

FOLDER contains sweeps of thousands of trials; docs/statistics.md has the commands that make them.
Their trials are taken as the whole population, and their statistics as the truth. Samples of n
trials are drawn from it with replacement, the same trials under every configuration, as one
experiment would have them. The tables replace those in the page.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from markdown_tables import table

from trl_explore.jobs.reading import find_jobs, read_job
from trl_explore.names import strategy_label
from trl_explore.statistics import samples
from trl_explore.statistics.estimates import Estimate
from trl_explore.statistics.means import mean_difference, mean_interval
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import select
from trl_explore.statistics.samples import Sample
from trl_explore.statistics.survival import time_per_success
from trl_explore.thesis import CLAIMS, Claim, Study, check_claims, rules
from trl_explore.thesis.study import STRATEGIES

SIZES = (10, 30, 100, 1000)
CLAIM_SIZES = (30, 100, 1000)
GROUPS = ("env", "correction", "baseline")
STATISTICS: dict[str, Callable[[Outcomes], Estimate]] = {
    "mean iterations": lambda o: mean_interval(samples.iterations(o)),
    "iterations per success": lambda o: time_per_success(samples.iterations(o)),
    "mean score": lambda o: mean_interval(samples.scores(o)),
    "mean frames": lambda o: mean_interval(samples.frames(o)),
}


def drawn(o: Outcomes, index: np.ndarray, first: int = 0) -> Outcomes:
    """The trials at ``index``, as the trials ``first``, ``first`` + 1, ... of a job."""
    return replace(select(o, index), trial=first + np.arange(len(index)))


def coverage(jobs: dict[str, Outcomes], n: int, repetitions: int) -> Iterable[Sequence[str]]:
    """Per strategy: how often each interval contains the truth, %."""
    rng = np.random.default_rng(n)
    for name, o in jobs.items():
        truth = [statistic(o).value for statistic in STATISTICS.values()]
        hits = np.zeros(len(STATISTICS))
        for _ in range(repetitions):
            sample = drawn(o, rng.integers(len(o), size=n))
            found = [statistic(sample) for statistic in STATISTICS.values()]
            hits += [e.low <= t <= e.high for e, t in zip(found, truth, strict=True)]
        yield [strategy_label(name), f"{n:,}", *(_percent(h, repetitions) for h in hits)]


def differences(jobs: dict[str, Outcomes], n: int, repetitions: int) -> Iterable[Sequence[str]]:
    """Per pair of strategies: coverage of the paired and unpaired differences, %."""
    rng = np.random.default_rng(n)
    names = list(jobs)
    of = (samples.iterations, samples.scores)
    for a, b in ((a, b) for i, a in enumerate(names) for b in names[i + 1 :]):
        truth = [f(jobs[a]).values.mean() - f(jobs[b]).values.mean() for f in of]
        hits = np.zeros(4)
        for _ in range(repetitions):
            i, j = rng.integers(len(jobs[a]), size=(2, n))
            x, y, other = drawn(jobs[a], i), drawn(jobs[b], i), drawn(jobs[b], j, first=n)
            found = [mean_difference(f(x), f(z)).estimate for z in (y, other) for f in of]
            hits += [e.low <= t <= e.high for e, t in zip(found, 2 * truth, strict=True)]
        cells = [_percent(h, repetitions) for h in hits]
        yield [f"{strategy_label(a)} − {strategy_label(b)}", f"{n:,}", *cells]


def equal_means(jobs: dict[str, Outcomes], n: int, repetitions: int) -> Iterable[Sequence[str]]:
    """Per pair: how often a difference is found although the means are equal, %.

    The times of the second are multiplied by a factor that makes the restricted means of the whole
    populations equal, and the shapes stay different.
    """
    rng = np.random.default_rng(n)
    names = [name for name in jobs if name not in ("random", "argmax")]
    for a, b in ((a, b) for i, a in enumerate(names) for b in names[i + 1 :]):
        x, y = samples.iterations(jobs[a]), _same_mean(samples.iterations(jobs[b]), jobs[a])
        wrong = np.zeros(2)
        for _ in range(repetitions):
            i, j = rng.integers(len(x), size=(2, n))
            first, paired, loose = _renamed(x, i), _renamed(y, i), _renamed(y, j, first=n)
            wrong += [mean_difference(first, z).sign() != 0 for z in (paired, loose)]
        cells = [_percent(w, repetitions) for w in wrong]
        yield [f"{strategy_label(a)}, {strategy_label(b)}", f"{n:,}", *cells]


def verdicts(
    study: Study, sizes: Sequence[int], repetitions: int, claims: Sequence[Claim] = CLAIMS
) -> Iterable[Sequence[str]]:
    """Per claim: the truth, and how often it is decided, and decided wrongly, %.

    The truth is the verdict on the whole population; where even that is open, the verdict of its
    point estimates.
    """
    points = check_claims(replace(study, level=1e-6), claims)
    truth = [
        (whole if whole.finding.verdict != "open" else point).finding.verdict
        for whole, point in zip(check_claims(study, claims), points, strict=True)
    ]
    found = {n: [Counter[str]() for _ in claims] for n in sizes}
    for n in sizes:
        rng = np.random.default_rng(n)
        for _ in range(repetitions):
            index = rng.random(n)
            small = [drawn(o, (index * len(o)).astype(int)) for o in study.outcomes]
            # The verdicts rest on the thesis's costs alone.
            with patch.object(rules, "COSTS", rules.THESIS_COSTS):
                decided = check_claims(replace(study, outcomes=small), claims)
            for counter, checked in zip(found[n], decided, strict=True):
                counter[checked.finding.verdict] += 1
    for k, claim in enumerate(claims):
        if truth[k] == "not measured":
            continue
        other = {"holds": "does not hold", "does not hold": "holds"}.get(truth[k], "")
        cells = []
        for n in sizes:
            definite = found[n][k]["holds"] + found[n][k]["does not hold"]
            cells += [_percent(definite, repetitions), _percent(found[n][k][other], repetitions)]
        yield [f"`{claim.id}`", truth[k], *cells]


def read_population(folder: Path) -> list[Outcomes]:
    """Every job at or below a folder."""
    return [read_job(job) for job in find_jobs(folder)]


def save(outcomes: Sequence[Outcomes], path: Path, trials: int) -> None:
    """Keep the first trials of each job, what a claim reads of them, in one small file."""
    kept = [select(o, np.arange(min(trials, len(o)))) for o in outcomes]
    facts = [
        {
            "name": o.name, "experiment": o.experiment, "strategy": o.strategy,
            "parameters": dict(o.parameters), "cap": o.cap, "threshold": o.threshold,
            "window": o.window, "config": {g: o.config[g] for g in GROUPS},
        }
        for o in kept
    ]  # fmt: skip
    np.savez_compressed(
        path,
        facts=json.dumps(facts),
        iterations=np.stack([o.durations for o in kept]).astype(np.int16),
        converged=np.stack([o.converged for o in kept]),
        frames=np.stack([o.frames for o in kept]).astype(np.int32),
        score=np.stack([o.score for o in kept]).astype(np.float32),
    )


def load(path: Path) -> list[Outcomes]:
    """What :func:`save` has kept."""
    with np.load(path) as arrays:
        facts, columns = json.loads(str(arrays["facts"])), dict(arrays)
    n = columns["iterations"].shape[1]
    return [
        Outcomes(
            **fact,
            trial=np.arange(n),
            seed=np.zeros(n, dtype=np.int64),
            iterations=columns["iterations"][k].astype(np.int64),
            converged=columns["converged"][k],
            score=columns["score"][k].astype(np.float64),
            frames=columns["frames"][k].astype(np.int64),
            seconds=np.zeros(n),
            status=np.where(columns["converged"][k], "converged", "capped"),
        )
        for k, fact in enumerate(facts)
    ]


def main() -> None:
    """Write the tables into the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--repetitions", type=int, default=400)
    parser.add_argument("--only", nargs="*", default=["coverage", "differences", "level", "claims"])
    parser.add_argument("--out", type=Path, default=Path("docs/statistics.md"))
    parser.add_argument("--save", type=Path, help="keep 500 trials of each job in this file")
    options = parser.parse_args()
    outcomes, many = read_population(options.folder), options.repetitions
    if options.save:
        save(outcomes, options.save, 500)
    thesis = {
        name: next(o for o in outcomes if o.experiment == "thesis" and o.strategy == name)
        for name in STRATEGIES
    }
    heads = [x for n in CLAIM_SIZES for x in (f"decided, {n:,}", f"wrong, {n:,}")]
    tables: dict[str, Callable[[], str]] = {
        "coverage": lambda: table(
            ["strategy", "n", *STATISTICS],
            [row for n in SIZES for row in coverage(thesis, n, many)],
        ),
        "differences": lambda: table(
            ["difference", "n", "iterations, paired", "score, paired", "iterations, unpaired",
             "score, unpaired"],
            [row for n in SIZES for row in differences(thesis, n, many)],
        ),
        "level": lambda: table(
            ["pair", "n", "paired", "unpaired"],
            [row for n in SIZES for row in equal_means(thesis, n, many)],
        ),
        "claims": lambda: table(
            ["claim", "truth", *heads], verdicts(Study(outcomes), CLAIM_SIZES, many), left=2
        ),
    }  # fmt: skip
    for name in options.only:
        write(options.out, name, tables[name]())


def write(page: Path, name: str, text: str) -> None:
    """Replace what stands in the page between the two marks of a table."""
    first, last = f"<!-- {name} -->", f"<!-- end of {name} -->"
    before, _, rest = page.read_text(encoding="utf-8").partition(first)
    after = rest.partition(last)[2]
    page.write_text(f"{before}{first}\n{text}\n{last}{after}", encoding="utf-8")


def _same_mean(y: Sample, other: Outcomes) -> Sample:
    """Times of ``y`` that pass, multiplied so that the mean is that of ``other``."""
    wanted = samples.iterations(other).values.mean()
    good = y.converged
    factor = (wanted * len(y) - y.values[~good].sum()) / y.values[good].sum()
    return replace(y, values=np.where(good, y.values * factor, y.values))


def _renamed(s: Sample, index: np.ndarray, first: int = 0) -> Sample:
    return replace(s.at(index), keys=tuple((0, first + i) for i in range(len(index))))


def _percent(count: float, of: int) -> str:
    return f"{100 * count / of:.1f}"


if __name__ == "__main__":
    main()
