"""Decisions on means and quantiles.

Functions that return a :data:`UnitDecision` are shared by similar claims.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from trl_explore.names import option_label, strategy_label
from trl_explore.statistics.comparisons import compare_all
from trl_explore.statistics.power import trials_to_settle
from trl_explore.statistics.samples import Sample
from trl_explore.thesis import rules
from trl_explore.thesis.rules import FAILS, HOLDS, OPEN, Decision, Finding, UnitDecision
from trl_explore.thesis.shares import DECAY, decay_grid
from trl_explore.thesis.study import NotMeasuredError, Study, Unit

TEMPERATURE = 1.0
"""The temperature of the thesis."""
NEGLIGIBLE = 0.05
DRASTICALLY = 0.5


def samples(study: Study, strategies: Iterable[str], unit: Unit) -> dict[str, Sample]:
    """One quantity of each strategy."""
    return {name: study.sample(study.strategy(name), unit) for name in strategies}


def smaller(study: Study, pairs: Iterable[tuple[Sample, Sample]]) -> Finding:
    """mean(a) < mean(b) for every pair."""
    return rules.all_of([rules.mean_less(a, b) for a, b in pairs], study.level)


def least(strategy: str, *others: str, converging: bool = False) -> UnitDecision:
    """mean(strategy) < mean(other) for every other strategy.

    Args:
        strategy: its name.
        others: names of the others; none: all of the study.
        converging: use only trials that converge, and strategies with at least one.
    """

    def decide(study: Study, unit: Unit) -> Finding:
        names = (strategy, *others) if others else study.strategies
        found = samples(study, names, unit)
        if converging:
            found = {name: s.only(s.converged) for name, s in found.items()}
        best = found.pop(strategy)
        rest = [s for s in found.values() if len(s) > 0]
        if len(best) == 0 or not rest:
            return Finding(
                OPEN, f"no trials of {strategy_label(strategy)}, or none of the others, converge"
            )
        return smaller(study, [(best, other) for other in rest])

    return decide


def most(strategy: str, *others: str) -> UnitDecision:
    """mean(strategy) > mean(other) for each of ``others``."""

    def decide(study: Study, unit: Unit) -> Finding:
        worst, *rest = samples(study, (strategy, *others), unit).values()
        return smaller(study, [(other, worst) for other in rest])

    return decide


def best_rate_is_least(study: Study, unit: Unit) -> Finding:
    """mean(0.99) < mean(rate) for every other rate of the decay grid."""
    grid = decay_grid(study)
    found = {rate: study.sample(o, unit, f"rate {rate:g}") for rate, o in grid.items()}
    best = found.pop(DECAY)
    return smaller(study, [(best, other) for other in found.values()])


def decaying_beats_constant(study: Study, unit: Unit) -> Finding:
    """mean(decaying) < mean(constant) over the trials that converge under both."""
    both = samples(study, ("decaying_epsilon_greedy", "epsilon_greedy"), unit).values()
    a, b = (s.only(s.converged) for s in both)
    return smaller(study, [(a, b)])


def argmax_long_when_it_passes(study: Study, unit: Unit) -> Finding:
    """mean(failing argmax trials) < mean(passing argmax trials)."""
    s = study.sample(study.strategy("argmax"), unit)
    failing = s.only(~s.converged, "failing argmax")
    return smaller(study, [(failing, s.only(s.converged, "passing argmax"))])


def strategies_matter(study: Study) -> Finding:
    """At least one pair of strategies differs in its restricted means (Holm)."""
    jobs = [study.strategy(name) for name in study.strategies]
    table = compare_all(jobs, level=study.level)
    n, cap = table[0].n_a, table[0].cap
    differing = [c for c in table if c.winner is not None]
    text = f"{len(differing)} of {len(table)} pairs of strategies differ after Holm's correction"
    if differing:
        p = rules.p_value(min(c.p_holm for c in differing))
        return Finding(HOLDS, f"{text} (smallest p {p})")
    margin = NEGLIGIBLE * cap
    if all(c.difference.inside(-margin, margin) and c.sd > 0 for c in table):
        return Finding(FAILS, f"{text}, and every interval lies within ± {margin:.0f} iterations")
    needed = [trials_to_settle(c.difference, 0.0, n) for c in table]
    known = [m for m in needed if m is not None]
    return Finding(OPEN, text, max(min(known), n + 1) if known else None)


def temperature_improves(study: Study) -> Finding:
    """mean(T) < mean(1) for at least one T, where the agent learns the policy that it acts by."""
    return acting_temperature_improves(study.under("Behaviour"))


def acting_temperature_improves(study: Study) -> Finding:
    """mean(T) < mean(1) for at least one other temperature T of the grid."""
    grid = study.grid("temperature_grid", "temperature")
    found = {t: study.sample(o, "iterations", f"(T = {t:g})") for t, o in grid.items()}
    plain = found.pop(TEMPERATURE, None)
    if plain is None or not found:
        raise NotMeasuredError("the grid needs the temperature 1 and at least one other")
    return rules.any_of([rules.mean_less(s, plain) for s in found.values()])(study.level)


def preferred_beats_uniform(study: Study) -> Finding:
    """mean(softmax) < mean(ε-greedy) for both ε-greedy strategies, all with the per-step ratio."""
    return least("softmax", "epsilon_greedy", "decaying_epsilon_greedy")(
        study.under("PerStep"), "iterations"
    )


def exploring_costs_score(strategy: str) -> Decision:
    """mean(score while exploring) < mean(score of the same policies without the strategy)."""

    def decide(study: Study) -> Finding:
        o = study.strategy(strategy)
        if o.learned_score is None:
            raise NotMeasuredError(f"{strategy_label(strategy)} has no evaluations")
        known = np.isfinite(o.learned_score) & np.isfinite(o.score)
        behaved, learned = (
            Sample.of(values[known], label=f"score of {strategy_label(strategy)} {how}")
            for values, how in ((o.score, "exploring"), (o.learned_score, "not exploring"))
        )
        return smaller(study, [(behaved, learned)])

    return decide


def random_averages_25(study: Study) -> Finding:
    """22.5 ≤ mean final score ≤ 27.5."""
    score = study.sample(study.strategy("random"), "score")
    return rules.mean_within(score, 22.5, 27.5, "mean final score of random")(study.level)


def varies_greatly(strategy: str) -> UnitDecision:
    """The upper quartile of a strategy is more than twice the lower quartile."""
    return _by_quantiles(strategy, ((0.75, 1.0), (0.25, -2.0)), "upper − 2 × lower quartile")


def skewed(strategy: str, sign: float) -> UnitDecision:
    """The slowest decile is further from the median than the fastest (sign 1), or nearer (-1)."""
    weights = ((0.9, sign), (0.5, -2.0 * sign), (0.1, sign))
    tails = ("90 % quantile − median", "median − 10 % quantile")
    long, short = tails if sign > 0 else tails[::-1]
    return _by_quantiles(strategy, weights, f"({long}) − ({short})")


def _by_quantiles(strategy: str, weights: Sequence[tuple[float, float]], what: str) -> UnitDecision:
    def decide(study: Study, unit: Unit) -> Finding:
        s = study.sample(study.strategy(strategy), unit)
        return rules.quantiles_above_zero(s, weights, f"{s.label}: {what}")(study.level)

    return decide


def epsilon_greedies_alike(study: Study, unit: Unit) -> Finding:
    """4/5 ≤ mean(decaying) / mean(constant) ≤ 5/4."""
    a, b = samples(study, ("decaying_epsilon_greedy", "epsilon_greedy"), unit).values()
    what = "mean of decaying ε-greedy over mean of ε-greedy"
    return rules.mean_ratio(a, b, 1 / 1.25, 1.25, what)(study.level)


def baseline_drastic(study: Study) -> Finding:
    """mean(T - floor) with some baseline < ½ mean(T - floor) without, for every strategy.

    No trial passes before its first full window of episodes, the floor; learning has none.
    """
    parts = []
    for strategy in dict.fromkeys(o.strategy for o in study.experiment("baselines")):
        called = strategy_label(strategy)
        found = {}
        for name, o in study.choices("baselines", strategy, "baseline").items():
            label = f"{called} with {option_label('baseline', name)}"
            floor = 0.0 if study.measure == "learned" else float(o.window)
            found[name] = study.sample(o, "iterations", label).scaled(1.0, floor)
        plain = found.pop("Constant", None)
        if plain is None or not found:
            raise NotMeasuredError(f"{called} was not run both without and with a baseline")
        over = f"over that of {plain.label}"
        parts.append(
            rules.any_of(
                [
                    rules.mean_ratio(s, plain, 0.0, DRASTICALLY, f"mean of {s.label} {over}")
                    for s in found.values()
                ]
            )
        )
    return rules.all_of(parts, study.level)
