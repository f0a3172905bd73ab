"""Rules that only single claims of the thesis need, as parts for ``algebra``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import isnan
from typing import Any

import numpy as np

from trl_explore.names import option_label, strategy_label
from trl_explore.statistics.comparisons import compare_all
from trl_explore.statistics.decomposition import aligned, share_of
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import pair_indices
from trl_explore.statistics.power import trials_for_rate_bound, trials_to_settle
from trl_explore.statistics.samples import Sample
from trl_explore.statistics.survival import probability_faster
from trl_explore.thesis import rules
from trl_explore.thesis.rules import FAILS, HOLDS, OPEN, Finding, Rule
from trl_explore.thesis.study import CAPS, NotMeasuredError, Study

Find = Callable[[Any], Mapping[str, Outcomes]]


def scores(study: Study, find: Find, of: str, low: float, high: float, above: float) -> list[Rule]:
    """P(low ≤ final score ≤ high) > ``above``."""
    score = study.strategy(of).score
    inside = int(np.count_nonzero((score >= low) & (score <= high)))
    what = f"{strategy_label(of)} trials score {low:g} to {high:g}"
    return [rules.share(inside, len(score), what, above=above)]


def passes_early(study: Study, find: Find, of: str, before: int) -> list[Rule]:
    """Fewer than 1 % of the trials that pass do so in fewer than ``before`` iterations."""
    o, called = study.strategy(of), strategy_label(of)
    passed = o.iterations[o.converged]
    if len(passed) == 0:
        return [lambda level: Finding(OPEN, f"0 of {len(o)} {called} trials pass")]
    what = f"passing {called} trials take fewer than {before} iterations"
    rule = _of_part(rules.never(int((passed < before).sum()), len(passed), what), passed, o)

    def decide(level: float) -> Finding:
        found = rule(level)
        return replace(found, evidence=f"{found.evidence}; the fastest takes {passed.min()}")

    return [decide]


def converge_late(study: Study, find: Find, of: list[str], below: float) -> list[Rule]:
    """P(passes by 5000 | not passed at 1000) < ``below`` for each strategy.

    Of several strategies, those with fewer than 1 % of such trials do not count.
    """
    found, early = [], CAPS["thesis"]
    for name in of:
        o, called = _long_run(study, find, name), strategy_label(name)
        pending = o.durations > early
        n, late = int(pending.sum()), int((pending & o.converged).sum())
        few = rules.never(n, len(o), f"trials of {called} are unconverged at {early}")
        if n == 0 and len(of) == 1:
            raise NotMeasuredError(f"every trial of {called} converged within {early}")
        if n == 0:
            found.append(few)
            continue
        what = f"trials of {called} unconverged at {early} converge later"
        rule = _of_part(rules.share(late, n, what, below=below), o.durations[pending], o)
        found.append(rule if len(of) == 1 else rules.any_of([rule, few]))
    return found


def _long_run(study: Study, find: Find, strategy: str) -> Outcomes:
    """A strategy with the cap of 5000; decaying ε-greedy also from the decay grid."""
    try:
        return study.strategy(strategy, "long_runs")
    except NotMeasuredError:
        if strategy != "decaying_epsilon_greedy":
            raise
        return next(iter(find({"grid": "decay", "value": 0.99}).values()))


def _of_part(rule: Rule, part: np.ndarray, whole: Outcomes) -> Rule:
    """A rule on some trials only; the trials needed are those of the whole configuration."""

    def scaled(level: float) -> Finding:
        found = rule(level)
        needed = found.trials_needed
        return found if needed is None else replace(
            found, trials_needed=needed * len(whole) / len(part))  # fmt: skip

    return scaled


def faster(study: Study, find: Find, first: Any, second: Any) -> list[Rule]:
    """P(first converges before second) > ½ for each second."""
    ((called, a),) = find(first).items()
    return [_faster(called, a, other, b) for other, b in find(second).items()]


def _faster(first: str, a: Outcomes, second: str, b: Outcomes) -> Rule:
    i, j = pair_indices(a, b)
    paired = len(i) > 0
    if not paired:
        i, j = np.arange(len(a)), np.arange(len(b))
    n = min(len(i), len(j))

    def rule(level: float) -> Finding:
        times = a.durations[i], a.converged[i], b.durations[j], b.converged[j]
        chance = probability_faster(*times, paired=paired, level=level)
        verdict = rules.decided(chance.above(0.5), chance.below(0.5))
        needed = trials_for_rate_bound(chance.value, 0.5, level=level)
        text = f"{first} converges before {second} in {rules.percent(chance)}"
        design = f"({n} {'pairs' if paired else 'trials'})"
        return Finding(verdict, f"{text} {design}", rules.more(verdict, needed, n))

    return rule


def differ(study: Study, find: Find, negligible: float) -> list[Rule]:
    """At least one pair of strategies differs in its restricted means (Holm).

    It does not hold if the intervals of all differences lie within ``negligible`` × cap.
    """
    jobs = [study.strategy(name) for name in study.strategies]

    def rule(level: float) -> Finding:
        table = compare_all(jobs, level=level)
        n, cap = table[0].n_a, table[0].cap
        real = [c for c in table if c.winner is not None]
        text = f"{len(real)} of {len(table)} pairs of strategies differ after Holm's correction"
        if real:
            p = rules.p_value(min(c.p_holm for c in real))
            return Finding(HOLDS, f"{text} (smallest p {p})")
        margin = negligible * cap
        if all(c.difference.inside(-margin, margin) and c.sd > 0 for c in table):
            text += f", and every interval lies within ± {margin:.0f} iterations"
            return Finding(FAILS, text)
        needed = [trials_to_settle(c.difference, 0.0, n) for c in table]
        known = [m for m in needed if m is not None]
        return Finding(OPEN, text, max(min(known), n + 1) if known else None)

    return [rule]


def exploring_costs(study: Study, find: Find, of: str) -> list[Rule]:
    """mean(score while exploring) < mean(score of the same policies without the strategy)."""
    o, called = study.strategy(of), strategy_label(of)
    if o.learned_score is None:
        raise NotMeasuredError(f"{called} has no evaluations")
    known = np.isfinite(o.learned_score) & np.isfinite(o.score)
    behaved, learned = (
        Sample.of(values[known], label=f"score of {called} {how}")
        for values, how in ((o.score, "exploring"), (o.learned_score, "not exploring"))
    )
    return [rules.mean_less(behaved, learned)]


def baseline(study: Study, find: Find, below: float) -> list[Rule]:
    """mean(T - floor) with some baseline < ``below`` × mean(T - floor) without, per strategy.

    No trial passes before its first full window of episodes, the floor; learning has none.
    """
    found = []
    for strategy in dict.fromkeys(o.strategy for o in study.experiment("baselines")):
        called, by_name = strategy_label(strategy), {}
        for name, o in study.choices("baselines", strategy, "baseline").items():
            label = f"{called} with {option_label('baseline', name)}"
            floor = 0.0 if study.measure == "learned" else float(o.window)
            by_name[name] = study.sample(o, "iterations", label).scaled(1.0, floor)
        plain = by_name.pop("Constant", None)
        if plain is None or not by_name:
            raise NotMeasuredError(f"{called} was not run both without and with a baseline")
        found.append(rules.any_of([
            rules.mean_ratio(s, plain, 0.0, below, f"mean of {s.label} over that of {plain.label}")
            for s in by_name.values()
        ]))  # fmt: skip
    return found


def bias_explains(study: Study, find: Find, of: str, above: float) -> list[Rule]:
    """E[T_uncorrected − T_ratio] / E[T_uncorrected − T_softmax] > ``above`` for min(T, cap)."""
    called = strategy_label(of)
    jobs = study.corrected(of, ["NoCorrection", "PerStep"]).values()
    best = study.under("NoCorrection").strategy("softmax")
    samples = [study.sample(o, "iterations") for o in (*jobs, best)]
    x, y, z = aligned([s.keys for s in samples], [s.values for s in samples])
    if not len(x):
        raise NotMeasuredError(f"{called} and softmax share no trial")

    def rule(level: float) -> Finding:
        share = share_of(x - y, x - z, level=level)
        excess = f"the {(x - z).mean():,.0f} iterations beyond softmax"
        if isnan(share.value):
            return Finding(OPEN, f"{excess} may be none ({len(x):,} trials)")
        text = (
            f"the bias explains {100 * share.value:.0f} % of {excess}, {100 * level:g} %"
            f" interval {100 * share.low:.0f} to {100 * share.high:.0f} % ({len(x):,} trials)"
        )
        verdict = rules.decided(share.above(above), share.below(above))
        needed = trials_to_settle(share, above, len(x))
        return Finding(verdict, text, rules.more(verdict, needed, len(x)))

    return [rule]
