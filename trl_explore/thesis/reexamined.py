"""Which of the thesis's conclusions remain when the off-policy bias of the gradient is corrected.

Under argmax, ε-greedy or a temperature other than 1, actions are drawn from μ but the gradient is
computed as if they came from π. The experiments ``corrections`` and ``corrections_temperature``
repeat the comparison with corrections in the loss, such as the ratio π/μ, on the same seeds.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan

from trl_explore.names import option_label, strategy_label
from trl_explore.statistics.decomposition import aligned, share_of
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.power import trials_to_settle
from trl_explore.thesis import rules
from trl_explore.thesis.claims import CLAIMS as THESIS
from trl_explore.thesis.claims import Claim, check_claims
from trl_explore.thesis.means import smaller
from trl_explore.thesis.rules import HOLDS, NOT_MEASURED, OPEN, Decision, Finding
from trl_explore.thesis.shares import all_passing
from trl_explore.thesis.study import NotMeasuredError, Study

PLAIN, RATIO = "NoCorrection", "PerStep"
UNBIASED = ("PerDecision", "Trajectory")
HOT = 1.5

CONCLUSIONS: tuple[Claim, ...] = tuple(
    claim
    for claim in THESIS
    if claim.id
    in {
        "score.argmax_passes_less_than_half",
        "score.epsilon_greedy_sometimes_fails",
        "score.decaying_epsilon_greedy_sometimes_fails",
        "score.others_pass_almost_every_time",
        "iterations.decaying_fewer_than_epsilon_greedy",
        "iterations.softmax_fewest",
        "iterations.epsilon_greedy_most",
        "conclusion.strategies_matter",
        "conclusion.softmax_performs_best",
        "outlook.acting_temperature_improves",
    }
)
"""The thesis's statements that can be tested again under a correction."""


@dataclass(frozen=True)
class Reexamined:
    """A statement of the thesis, decided without and with correction on the same trials."""

    claim: Claim
    plain: Finding
    corrected: Finding

    @property
    def outcome(self) -> str:
        """Effect of the correction on the verdict."""
        for undecided in (NOT_MEASURED, OPEN):
            if undecided in (self.plain.verdict, self.corrected.verdict):
                return undecided
        if self.plain.verdict == HOLDS:
            return "survives" if self.corrected.verdict == HOLDS else "falls"
        return "becomes true" if self.corrected.verdict == HOLDS else "false either way"


def reexamine(study: Study) -> list[Reexamined]:
    """Decide each of ``CONCLUSIONS`` twice, with the same test as for the thesis.

    Args:
        study: study with the experiments ``corrections`` and ``corrections_temperature``.
    """
    without, under = (check_claims(study.under(name), CONCLUSIONS) for name in (PLAIN, RATIO))
    return [Reexamined(a.claim, a.finding, b.finding) for a, b in zip(without, under, strict=True)]


def mostly_bias(strategy: str) -> Decision:
    """E[T_uncorrected − T_ratio] / E[T_uncorrected − T_softmax] > 1/2 for min(T, cap), on pairs."""

    def decide(study: Study) -> Finding:
        jobs = study.choices("corrections", strategy, "correction")
        plain, ratio = _need(jobs, PLAIN, strategy), _need(jobs, RATIO, strategy)
        best = study.under(PLAIN).strategy("softmax")
        samples = [study.sample(o, "iterations") for o in (plain, ratio, best)]
        x, y, z = aligned([s.keys for s in samples], [s.values for s in samples])
        if not len(x):
            raise NotMeasuredError(f"{strategy_label(strategy)} and softmax share no trial")
        share = share_of(x - y, x - z, level=study.level)
        excess = f"the {(x - z).mean():,.0f} iterations beyond softmax"
        if isnan(share.value):
            return Finding(OPEN, f"{excess} may be none ({len(x):,} trials)")
        text = (
            f"the bias explains {100 * share.value:.0f} % of {excess}, {100 * study.level:g} %"
            f" interval {100 * share.low:.0f} to {100 * share.high:.0f} % ({len(x):,} trials)"
        )
        verdict = rules.decided(share.above(rules.MOSTLY), share.below(rules.MOSTLY))
        needed = trials_to_settle(share, rules.MOSTLY, len(x))
        return Finding(verdict, text, rules.more(verdict, needed, len(x)))

    return decide


def argmax_beyond_repair(study: Study) -> Finding:
    """p(argmax passes) < 80 % under every correction."""
    jobs = study.choices("corrections", "argmax", "correction")
    _need(jobs, RATIO, "argmax")
    passing = {f"argmax trials pass, {option_label('correction', n)}": o for n, o in jobs.items()}
    return all_passing(study, passing, below=rules.ALMOST_ALWAYS)


def variance_costs_more(study: Study) -> Finding:
    """mean(ratio) < mean(unbiased weights), for both ε-greedy strategies."""
    pairs = []
    for strategy in ("epsilon_greedy", "decaying_epsilon_greedy"):
        jobs = study.choices("corrections", strategy, "correction")
        ratio, *unbiased = (
            study.sample(
                _need(jobs, name, strategy),
                "iterations",
                f"{strategy_label(strategy)} with {option_label('correction', name)}",
            )
            for name in (RATIO, *UNBIASED)
        )
        pairs += [(ratio, other) for other in unbiased]
    return smaller(study, pairs)


def hot_softmax_repaired(study: Study) -> Finding:
    """At T = 1.5, p(pass) < 1 % without the ratio and p(pass) > 90 % with it."""
    parts = []
    for correction in (PLAIN, RATIO):
        grid = study.under(correction).grid("temperature_grid", "temperature")
        how = option_label("correction", correction)
        if HOT not in grid:
            raise NotMeasuredError(f"T = {HOT}, {how}, was not run")
        o, what = grid[HOT], f"trials pass at T = {HOT}, {how}"
        if correction == PLAIN:
            parts.append(rules.never(int(o.converged.sum()), len(o), what))
        else:
            parts.append(rules.passing(o, what, above=rules.CONSISTENTLY))
    return rules.all_of(parts, study.level)


def every_temperature_serves(study: Study) -> Finding:
    """With the gradient of μ, the pass rate is p > 90 % at every temperature."""
    grid = study.under("Behaviour").grid("temperature_grid", "temperature")
    passing = {f"trials pass at T = {t:g}": o for t, o in grid.items()}
    return all_passing(study, passing, above=rules.CONSISTENTLY)


def _need(jobs: dict[str, Outcomes], name: str, strategy: str) -> Outcomes:
    if name not in jobs:
        how = option_label("correction", name)
        raise NotMeasuredError(f"{strategy_label(strategy)} was not run with {how}")
    return jobs[name]


CLAIMS = (
    Claim("why.epsilon_greedy_mostly_bias", "experiment corrections",
          "Most of the extra iterations of ε-greedy over softmax come from the bias of its"
          " gradient, not from its exploration.",
          "The per-step ratio removes more than half of the mean excess of its iterations over"
          " those of softmax (restricted to the cap, same seed and trial; Fieller’s interval of"
          " the share).", mostly_bias("epsilon_greedy")),
    Claim("why.decaying_mostly_bias", "experiment corrections",
          "Most of the extra iterations of decaying ε-greedy over softmax come from the bias of"
          " its gradient.",
          "As for ε-greedy.", mostly_bias("decaying_epsilon_greedy")),
    Claim("why.argmax_beyond_repair", "experiment corrections",
          "No correction makes argmax pass almost every time.",
          "Argmax passes in less than 80 % of trials under every correction (exact intervals).",
          argmax_beyond_repair),
    Claim("why.variance_costs_more", "experiment corrections",
          "Removing the bias entirely costs more than it gains: with per-decision or trajectory"
          " weights, both ε-greedy strategies take longer than with the per-step ratio.",
          "The mean number of iterations, restricted to the cap, is smaller with the per-step"
          " ratio than with either kind of unbiased weights, for both strategies (interval of the"
          " paired difference).", variance_costs_more),
    Claim("why.hot_softmax_repaired", "experiment corrections_temperature",
          "Softmax at temperature 1.5 never passes without correction, and passes consistently"
          " with the per-step ratio.",
          "Without correction, fewer than 1 % of trials pass. With the ratio, more than 90 % pass"
          " (exact intervals).", hot_softmax_repaired),
    Claim("why.every_temperature_serves", "experiment corrections_temperature",
          "With the gradient of μ, softmax passes consistently at every temperature of the grid.",
          "More than 90 % of trials pass at each temperature (exact intervals).",
          every_temperature_serves),
)  # fmt: skip
"""Statements about the cause, which the thesis does not make."""
