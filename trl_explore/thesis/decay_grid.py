"""§2.3.2: which decay rate is best; §2.4.3: whether a late trial ever converges."""

from __future__ import annotations

from collections import Counter

import numpy as np

from trl_explore.statistics.estimates import pass_rate
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import trial_keys
from trl_explore.thesis import rules
from trl_explore.thesis.model import Claim, Finding
from trl_explore.thesis.study import CAPS, NotMeasuredError, Study

BEST = 0.99


def higher_rates_pass(study: Study, rng: np.random.Generator) -> Finding:
    """Ask p > 90 % for every rate above the median of the grid."""
    grid = _grid(study)
    middle = float(np.median(list(grid)))
    return rules.all_of(
        [
            rules.share_above(
                int(o.converged.sum()), len(o), rules.CONSISTENTLY, f"trials pass at rate {rate:g}"
            )
            for rate, o in grid.items()
            if rate > middle
        ],
        study.level,
    )


def best_rate_always_passes(study: Study, rng: np.random.Generator) -> Finding:
    """No trial of the rate 0.99 fails."""
    o = _grid(study)[BEST]
    failed = len(o) - int(o.converged.sum())
    return rules.never(failed, len(o), f"trials fail at rate {BEST}")(study.level)


def best_rate_is_fastest(study: Study, rng: np.random.Generator, unit: str) -> Finding:
    """mean(0.99) < mean(rate) for every other rate of the grid."""
    grid = _grid(study)
    samples = {rate: study.sample(o, unit, f"rate {rate:g}") for rate, o in grid.items()}
    best = samples.pop(BEST)
    return rules.all_of(
        [rules.mean_less(best, s, rng, resamples=study.resamples) for s in samples.values()],
        study.level,
    )


def late_trials_never_converge(study: Study, rng: np.random.Generator) -> Finding:
    """Ask P(converges by 5000 | not converged at 1000) < ½ over all rates of the grid.

    The rates share their trials, so that their runs are no independent evidence. The interval
    is that of Kish's effective number of trials, (Σ m)² / Σ m² for trials with m pending runs.
    """
    grid = _grid(study)
    late, runs = 0, Counter[tuple[int, int]]()
    for o in grid.values():
        pending = o.durations > CAPS["thesis"]
        late += int((pending & o.converged).sum())
        runs.update(key for key, p in zip(trial_keys(o), pending, strict=True) if p)
    total = runs.total()
    if total == 0:
        raise NotMeasuredError(f"every trial of the grid converged within {CAPS['thesis']}")
    n = total**2 // sum(m**2 for m in runs.values())
    finding = rules.share_below(late / total * n, n, rules.MOSTLY, "runs")(study.level)
    needed = finding.trials_needed
    if needed is not None:
        # Only trials that are still running at 1000 count, and not all of them fully.
        needed = -(-needed * max(len(o) for o in grid.values()) // n)
    text = (
        f"{late} of {total} runs unconverged at {CAPS['thesis']} converge later:"
        f" {rules.percent(pass_rate(late / total * n, n, level=study.level))}"
        f" ({len(runs)} different trials, worth {n} independent ones)"
    )
    return Finding(finding.verdict, text, needed)


def _grid(study: Study) -> dict[float, Outcomes]:
    grid = study.grid("decay_grid", "decay")
    if BEST not in grid or len(grid) < 2:
        raise NotMeasuredError(f"the decay grid needs {BEST} and at least one other rate")
    return grid


CLAIMS = (
    Claim(
        id="decay_grid.higher_rates_pass",
        statement="The higher decay rates pass the task consistently.",
        place="§2.3.2, fig. 2.3",
        definition="Higher: above the median rate of the grid. Consistently: in more than 90 %"
        " of trials. The Wilson interval of each of them lies above 90 %.",
        needs=("decay_grid",),
        decide=higher_rates_pass,
    ),
    Claim(
        id="decay_grid.0.99_always_passes",
        statement="Decay rate 0.99 passes the task for all trials.",
        place="§2.3.2, fig. 2.3",
        definition="One failed trial refutes it; it holds where none fails and the Wilson"
        " interval of failing ends below 5 %.",
        needs=("decay_grid",),
        decide=best_rate_always_passes,
    ),
    Claim(
        id="decay_grid.0.99_fewest_iterations",
        statement="Decay rate 0.99 has the best performance in iterations.",
        place="§2.3.2, fig. 2.2",
        definition="Its mean number of iterations, restricted to the cap of 5000, is smaller than"
        " that of every other rate (paired bootstrap interval and sign-flip test).",
        needs=("decay_grid",),
        decide=lambda study, rng: best_rate_is_fastest(study, rng, "iterations"),
    ),
    Claim(
        id="decay_grid.0.99_least_time",
        statement="Decay rate 0.99 has the best performance in time until convergence.",
        place="§2.3.2, fig. 2.4",
        definition="Its mean time until convergence or the cap, trials run by themselves, is"
        " smaller than that of every other rate (bootstrap interval and permutation test).",
        needs=("decay_grid", "seconds"),
        decide=rules.with_frames(best_rate_is_fastest),
    ),
    Claim(
        id="decay_grid.late_trials_never_converge",
        statement="An agent that has not converged in 1000 iterations will probably never.",
        place="§2.4.3",
        definition="Of the runs of the decay grid that have not converged at 1000 iterations,"
        " fewer than half converge by 5000. Wilson interval, with the effective number of"
        " independent trials, since the rates share theirs. Only decaying ε-greedy ran so long.",
        needs=("decay_grid",),
        decide=late_trials_never_converge,
    ),
)
