"""Decisions on shares of trials, by their exact interval.

Functions that return a :data:`Decision` are shared by similar claims.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from trl_explore.names import strategy_label
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import pair_indices
from trl_explore.statistics.power import trials_for_rate_bound
from trl_explore.statistics.survival import probability_faster
from trl_explore.thesis import rules
from trl_explore.thesis.rules import OPEN, Decision, Finding
from trl_explore.thesis.study import CAPS, NotMeasuredError, Study

EPSILON, DECAY = 0.3, 0.99
"""The parameters of the thesis."""
EARLY = 450


def pass_rates(*strategies: str, **bound: float) -> Decision:
    """The pass rate of each strategy is p > ``above``, or p < ``below``."""
    return lambda study: all_passing(
        study,
        {f"{strategy_label(name)} trials pass": study.strategy(name) for name in strategies},
        **bound,
    )


def all_passing(study: Study, jobs: Mapping[str, Outcomes], **bound: float) -> Finding:
    """The same for each configuration; keys are phrases like "softmax trials pass"."""
    return rules.all_of([rules.passing(o, what, **bound) for what, o in jobs.items()], study.level)


def never_passes(strategy: str) -> Decision:
    """Fewer than 1 % of the trials of a strategy pass."""
    return lambda study: _share(study, strategy, rules.never, "pass")


def never_fails(strategy: str) -> Decision:
    """Fewer than 1 % of the trials of a strategy fail."""
    return lambda study: _share(study, strategy, rules.never, "fail")


def sometimes_fails(strategy: str) -> Decision:
    """More than 1 % of the trials of a strategy fail."""
    return lambda study: _share(study, strategy, rules.some, "fail")


def _share(study: Study, strategy: str, rule: Callable[..., rules.Rule], what: str) -> Finding:
    o = study.strategy(strategy)
    count = int(np.count_nonzero(o.converged == (what == "pass")))
    return rule(count, len(o), f"{strategy_label(strategy)} trials {what}")(study.level)


def only_one_epsilon_passes(study: Study) -> Finding:
    """p(ε = 0.3) > 80 % and p(ε) < 80 % for every other ε of the grid."""
    grid = study.grid("epsilon_grid", "epsilon")
    if EPSILON not in grid or len(grid) < 2:
        raise NotMeasuredError(f"the ε grid needs {EPSILON} and at least one other value")
    return rules.all_of(
        [
            rules.passing(
                o,
                f"trials pass at ε = {epsilon:g}",
                **{"above" if epsilon == EPSILON else "below": rules.ALMOST_ALWAYS},
            )
            for epsilon, o in grid.items()
        ],
        study.level,
    )


def decay_grid(study: Study) -> dict[float, Outcomes]:
    """The grid of decay rates, with the thesis's rate and at least one other."""
    grid = study.grid("decay_grid", "decay")
    if DECAY not in grid or len(grid) < 2:
        raise NotMeasuredError(f"the decay grid needs {DECAY} and at least one other rate")
    return grid


def higher_rates_pass(study: Study) -> Finding:
    """The pass rate is p > 90 % for every decay rate above the median of the grid."""
    grid = decay_grid(study)
    middle = float(np.median(list(grid)))
    higher = {f"trials pass at rate {rate:g}": o for rate, o in grid.items() if rate > middle}
    return all_passing(study, higher, above=rules.CONSISTENTLY)


def best_rate_always_passes(study: Study) -> Finding:
    """Fewer than 1 % of the trials of the decay rate 0.99 fail."""
    o = decay_grid(study)[DECAY]
    what = f"trials fail at rate {DECAY}"
    return rules.never(int((~o.converged).sum()), len(o), what)(study.level)


def late_trials(*strategies: str, below: float) -> Decision:
    """P(passes by 5000 | not passed at 1000) < ``below`` for each strategy.

    Of several strategies, those with fewer than 1 % of such trials do not count.
    """

    def decide(study: Study) -> Finding:
        rules_of, early = [], CAPS["thesis"]
        for name in strategies:
            o = _long_run(study, name)
            pending = o.durations > early
            n, late = int(pending.sum()), int((pending & o.converged).sum())
            called = strategy_label(name)
            few = rules.never(n, len(o), f"trials of {called} are unconverged at {early}")
            if n == 0 and len(strategies) == 1:
                raise NotMeasuredError(f"every trial of {called} converged within {early}")
            if n == 0:
                rules_of.append(few)
                continue
            what = f"trials of {called} unconverged at {early} converge later"
            rule = _of_part(rules.share(late, n, what, below=below), n, len(o))
            rules_of.append(rule if len(strategies) == 1 else rules.any_of([rule, few]))
        return rules.all_of(rules_of, study.level)

    return decide


def _long_run(study: Study, strategy: str) -> Outcomes:
    """A strategy with the cap of 5000; decaying ε-greedy also from the decay grid."""
    try:
        return study.strategy(strategy, "long_runs")
    except NotMeasuredError:
        if strategy != "decaying_epsilon_greedy":
            raise
        return decay_grid(study)[DECAY]


def _of_part(rule: rules.Rule, part: int, whole: int) -> rules.Rule:
    """A rule on some trials only; the trials needed are those of the whole configuration."""

    def scaled(level: float) -> Finding:
        finding = rule(level)
        needed = finding.trials_needed
        return finding if needed is None else replace(finding, trials_needed=needed * whole / part)

    return scaled


def argmax_needs_450(study: Study) -> Finding:
    """Fewer than 1 % of the trials of argmax that pass do so before iteration 450."""
    o = study.strategy("argmax")
    passed = o.iterations[o.converged]
    if len(passed) == 0:
        return Finding(OPEN, f"0 of {len(o)} argmax trials pass")
    early = int((passed < EARLY).sum())
    what = f"passing argmax trials take fewer than {EARLY} iterations"
    finding = _of_part(rules.never(early, len(passed), what), len(passed), len(o))(study.level)
    return replace(finding, evidence=f"{finding.evidence}; the fastest takes {passed.min()}")


def random_scores_between(study: Study) -> Finding:
    """P(20 ≤ final score ≤ 25) > 90 %."""
    score = study.strategy("random").score
    inside = int(np.count_nonzero((score >= 20) & (score <= 25)))
    what = "random trials score 20 to 25"
    return rules.share(inside, len(score), what, above=rules.CONSISTENTLY)(study.level)


def softmax_performs_best(study: Study) -> Finding:
    """P(softmax converges first) > ½ against every other strategy."""
    best = study.strategy("softmax")
    others = [study.strategy(name) for name in study.strategies if name != "softmax"]
    return rules.all_of([_faster(best, o) for o in others], study.level)


def _faster(a: Outcomes, b: Outcomes) -> rules.Rule:
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
        first, second = strategy_label(a.strategy), strategy_label(b.strategy)
        text = f"{first} converges before {second} in {rules.percent(chance)}"
        design = f"({n} {'pairs' if paired else 'trials'})"
        return Finding(verdict, f"{text} {design}", rules.more(verdict, needed, n))

    return rule
