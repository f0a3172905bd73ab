"""The hypothesis (§1.2) and the conclusion of the discussion."""

from __future__ import annotations

import numpy as np

from trl_explore.names import strategy_label
from trl_explore.statistics.comparisons import compare_all
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import pair_indices
from trl_explore.statistics.power import trials_for_difference, trials_for_rate_bound
from trl_explore.statistics.survival import probability_faster
from trl_explore.thesis import rules
from trl_explore.thesis.model import FAILS, HOLDS, OPEN, Claim, Finding
from trl_explore.thesis.study import STRATEGIES, Study

NEGLIGIBLE = 0.05


def strategies_matter(study: Study, rng: np.random.Generator) -> Finding:
    """Test whether any pair of strategies differs in its restricted mean (Holm)."""
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


def softmax_performs_best(study: Study, rng: np.random.Generator) -> Finding:
    """Ask P(softmax converges first) > ½ against each of the other strategies."""
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
        chance = probability_faster(
            a.durations[i],
            a.converged[i],
            b.durations[j],
            b.converged[j],
            paired=paired,
            level=level,
        )
        verdict = rules.decided(chance.above(0.5), chance.below(0.5))
        needed = trials_for_rate_bound(chance.value, 0.5, level=level)
        more = max(needed, n + 1) if verdict == OPEN and needed is not None else None
        first, second = strategy_label(a.strategy), strategy_label(b.strategy)
        text = f"{first} converges before {second} in {rules.percent(chance)}"
        return Finding(verdict, f"{text} ({n} {'pairs' if paired else 'trials'})", more)

    return rule


CLAIMS = (
    Claim(
        id="conclusion.strategies_matter",
        statement="The exploration strategy has an effect on the convergence of the agent.",
        place="Discussion",
        definition="The restricted mean number of iterations of at least one pair of the five"
        " strategies differs (sign-flip test with Holm's correction over all pairs). It does not"
        " hold where the intervals of all pairs lie within 5 % of the cap around zero.",
        needs=tuple(f"thesis/{name}" for name in STRATEGIES),
        decide=strategies_matter,
    ),
    Claim(
        id="conclusion.softmax_performs_best",
        statement="Softmax performs best of the five strategies.",
        place="§1.2 (hypothesis); Discussion",
        definition="Against each other strategy, softmax converges first in more than half of the"
        " trials; failing counts as later than any convergence, ties count half (Wilson"
        " interval).",
        needs=tuple(f"thesis/{name}" for name in STRATEGIES),
        decide=softmax_performs_best,
    ),
)
