"""Decisions on means and other statistics, by permutation test and bootstrap interval.

Functions that return a :data:`UnitDecision` are shared by similar claims.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from trl_explore.names import option_label, strategy_label
from trl_explore.statistics.bootstrap import bootstrap, mean
from trl_explore.statistics.comparisons import compare_all
from trl_explore.statistics.estimates import Estimate
from trl_explore.statistics.power import trials_for_difference
from trl_explore.thesis import rules
from trl_explore.thesis.rules import FAILS, HOLDS, OPEN, Finding, UnitDecision
from trl_explore.thesis.shares import DECAY, decay_grid
from trl_explore.thesis.study import NotMeasuredError, Sample, Study

TEMPERATURE = 1.0
"""The temperature of the thesis."""
NEGLIGIBLE = 0.05
DRASTICALLY = 0.5
# With fewer trials, a bootstrap interval is unreliable.
MIN_FOR_BOOTSTRAP = 8


def samples(study: Study, strategies: Iterable[str], unit: str) -> dict[str, Sample]:
    """One quantity of each strategy."""
    return {name: study.sample(study.strategy(name), unit) for name in strategies}


def smaller(
    study: Study, rng: np.random.Generator, pairs: Iterable[tuple[Sample, Sample]]
) -> Finding:
    """mean(a) < mean(b) for every pair."""
    parts = [rules.mean_less(a, b, rng, resamples=study.resamples) for a, b in pairs]
    return rules.all_of(parts, study.level)


def least(strategy: str, *, converging: bool = False) -> UnitDecision:
    """mean(strategy) < mean(other) for every other strategy.

    Args:
        strategy: its name.
        converging: use only trials that converge, and strategies with at least one.

    """

    def decide(study: Study, rng: np.random.Generator, unit: str) -> Finding:
        found = samples(study, study.strategies, unit)
        if converging:
            found = {name: s.only(s.converged) for name, s in found.items()}
        best = found.pop(strategy)
        others = [s for s in found.values() if len(s) > 0]
        if len(best) == 0 or not others:
            return Finding(
                OPEN, f"no trials of {strategy_label(strategy)}, or none of the others, converge"
            )
        return smaller(study, rng, [(best, other) for other in others])

    return decide


def most(strategy: str, *others: str) -> UnitDecision:
    """mean(strategy) > mean(other) for each of ``others``."""

    def decide(study: Study, rng: np.random.Generator, unit: str) -> Finding:
        worst, *rest = samples(study, (strategy, *others), unit).values()
        return smaller(study, rng, [(other, worst) for other in rest])

    return decide


def best_rate_is_least(study: Study, rng: np.random.Generator, unit: str) -> Finding:
    """mean(0.99) < mean(rate) for every other rate of the decay grid."""
    grid = decay_grid(study)
    found = {rate: study.sample(o, unit, f"rate {rate:g}") for rate, o in grid.items()}
    best = found.pop(DECAY)
    return smaller(study, rng, [(best, other) for other in found.values()])


def decaying_beats_constant(study: Study, rng: np.random.Generator, unit: str) -> Finding:
    """mean(decaying) < mean(constant) over the trials that converge under both."""
    both = samples(study, ("decaying_epsilon_greedy", "epsilon_greedy"), unit).values()
    a, b = (s.only(s.converged) for s in both)
    return smaller(study, rng, [(a, b)])


def argmax_long_when_it_passes(study: Study, rng: np.random.Generator, unit: str) -> Finding:
    """mean(failing argmax trials) < mean(passing argmax trials)."""
    s = study.sample(study.strategy("argmax"), unit)
    failing = s.only(~s.converged, "failing argmax")
    return smaller(study, rng, [(failing, s.only(s.converged, "passing argmax"))])


def strategies_matter(study: Study, rng: np.random.Generator) -> Finding:
    """At least one pair of strategies differs in its restricted means (Holm)."""
    jobs = [study.strategy(name) for name in study.strategies]
    table = compare_all(jobs, rng, level=study.level, resamples=study.resamples)
    n, cap = table[0].n_a, table[0].cap
    differing = [c for c in table if c.winner is not None]
    text = f"{len(differing)} of {len(table)} pairs of strategies differ after Holm's correction"
    if differing:
        p = rules.p_value(min(c.p_holm for c in differing))
        return Finding(HOLDS, f"{text} (smallest p = {p})")
    margin = NEGLIGIBLE * cap
    if n > 1 and all(c.difference.inside(-margin, margin) and c.sd > 0 for c in table):
        return Finding(FAILS, f"{text}, and every interval lies within ± {margin:.0f} iterations")
    strict = 1 - (1 - study.level) / len(table)
    needed = [trials_for_difference(c.sd, c.difference.value, level=strict) for c in table]
    known = [m for m in needed if m is not None]
    return Finding(OPEN, text, max(min(known), n + 1) if known else None)


def temperature_improves(study: Study, rng: np.random.Generator) -> Finding:
    """mean(T) < mean(1) for at least one other temperature T of the grid."""
    grid = study.grid("temperature_grid", "temperature")
    found = {t: study.sample(o, "iterations", f"(T = {t:g})") for t, o in grid.items()}
    plain = found.pop(TEMPERATURE, None)
    if plain is None or not found:
        raise NotMeasuredError("the grid needs the temperature 1 and at least one other")
    return rules.any_of(
        [rules.mean_less(s, plain, rng, resamples=study.resamples) for s in found.values()]
    )(study.level)


def random_averages_25(study: Study, rng: np.random.Generator) -> Finding:
    """22.5 ≤ mean final score ≤ 27.5."""
    score = study.strategy("random").score
    if not np.isfinite(score).all():
        raise NotMeasuredError("a random trial has no final score")

    def estimate(level: float) -> Estimate:
        # With few equal scores the bootstrap interval would have no width.
        e = bootstrap(mean, [score], rng, level=level, resamples=study.resamples)
        enough = len(score) >= MIN_FOR_BOOTSTRAP
        return e if enough else Estimate(e.value, np.nan, np.nan, level)

    what = "mean final score of random"
    return rules.within(estimate, len(score), 22.5, 27.5, what)(study.level)


def variation(strategy: str, low: float, high: float) -> UnitDecision:
    """The coefficient of variation s / x̄ of a strategy lies in [low, high]."""
    return _one_sample(_variation, "sd / mean", strategy, (low, high))


def skewness(strategy: str, low: float, high: float) -> UnitDecision:
    """The skewness m₃ / m₂^(3/2) of a strategy lies in [low, high]."""
    return _one_sample(_skewness, "skewness", strategy, (low, high))


def _one_sample(
    statistic: Callable[..., Any], name: str, strategy: str, bounds: tuple[float, float]
) -> UnitDecision:
    def decide(study: Study, rng: np.random.Generator, unit: str) -> Finding:
        x = study.sample(study.strategy(strategy), unit).values
        what = f"{name} of {strategy_label(strategy)}"
        return _bootstrapped(statistic, [x], False, bounds, what, study, rng)(study.level)

    return decide


def epsilon_greedies_alike(study: Study, rng: np.random.Generator, unit: str) -> Finding:
    """4/5 ≤ mean(decaying) / mean(constant) ≤ 5/4."""
    a, b = samples(study, ("decaying_epsilon_greedy", "epsilon_greedy"), unit).values()
    what = "mean of decaying ε-greedy over mean of ε-greedy"
    return _ratio(a, b, (1 / 1.25, 1.25), what, study, rng)(study.level)


def baseline_drastic(study: Study, rng: np.random.Generator) -> Finding:
    """mean(some baseline) < ½ mean(none), for every strategy."""
    parts = []
    for strategy in dict.fromkeys(o.strategy for o in study.experiment("baselines")):
        called = strategy_label(strategy)
        found = {
            name: study.sample(o, "iterations", f"{called} with {option_label('baseline', name)}")
            for name, o in study.choices("baselines", strategy, "baseline").items()
        }
        plain = found.pop("Constant", None)
        if plain is None or not found:
            raise NotMeasuredError(f"{called} was not run both without and with a baseline")
        over = f"over that of {plain.label}"
        parts.append(
            rules.any_of(
                [
                    _ratio(s, plain, (0.0, DRASTICALLY), f"mean of {s.label} {over}", study, rng)
                    for s in found.values()
                ]
            )
        )
    return rules.all_of(parts, study.level)


def _ratio(
    a: Sample,
    b: Sample,
    bounds: tuple[float, float],
    what: str,
    study: Study,
    rng: np.random.Generator,
) -> rules.Rule:
    x, y, paired = rules.align(a, b)
    return _bootstrapped(_ratio_of_means, [x, y], paired, bounds, what, study, rng)


def _bootstrapped(
    statistic: Callable[..., Any],
    arrays: Sequence[np.ndarray],
    paired: bool,
    bounds: tuple[float, float],
    what: str,
    study: Study,
    rng: np.random.Generator,
) -> rules.Rule:
    """The bootstrap interval of a statistic lies within ``bounds``; open with too few trials."""
    n = min(len(a) for a in arrays)
    if n < MIN_FOR_BOOTSTRAP:
        text = f"{what}: {n} trials, at least {MIN_FOR_BOOTSTRAP} are needed"
        return lambda level: Finding(OPEN, text)

    def estimate(level: float) -> Estimate:
        return bootstrap(
            statistic, arrays, rng, paired=paired, level=level, resamples=study.resamples
        )

    return rules.within(estimate, n, *bounds, what)


def _variation(x: np.ndarray) -> Any:
    return x.std(axis=-1, ddof=1) / x.mean(axis=-1)


def _ratio_of_means(x: np.ndarray, y: np.ndarray) -> Any:
    return x.mean(axis=-1) / y.mean(axis=-1)


def _skewness(x: np.ndarray) -> Any:
    d = x - x.mean(axis=-1, keepdims=True)
    m2, m3 = (d**2).mean(axis=-1), (d**3).mean(axis=-1)
    # Equal values have no skewness (NaN), but rounding makes m2 nonzero.
    flat = m2 <= (1e-12 * x.mean(axis=-1)) ** 2
    return np.where(flat, np.nan, m3 / np.where(flat, 1.0, m2) ** 1.5)
