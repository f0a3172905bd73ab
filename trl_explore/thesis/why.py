"""Which of the thesis's conclusions remain when the off-policy bias of the gradient is corrected.

Under argmax, ε-greedy or a temperature other than 1, actions are drawn from μ but the gradient is
computed as if they came from π. The experiments ``corrections`` and ``corrections_temperature``
repeat the comparison with corrections in the loss, such as the ratio π/μ, on the same seeds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trl_explore.names import option_label, strategy_label
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import common
from trl_explore.thesis import rules
from trl_explore.thesis.claims import CLAIMS as THESIS
from trl_explore.thesis.claims import Claim, check_claims
from trl_explore.thesis.means import smaller
from trl_explore.thesis.rules import HOLDS, NOT_MEASURED, OPEN, Decision, Finding
from trl_explore.thesis.shares import all_passing
from trl_explore.thesis.study import NotMeasuredError, Sample, Study

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
        "outlook.temperature_improves",
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


def reexamine(
    study: Study, plain: np.random.Generator, corrected: np.random.Generator
) -> list[Reexamined]:
    """Decide each of ``CONCLUSIONS`` twice, with the same test as for the thesis.

    Args:
        study: study with the experiments ``corrections`` and ``corrections_temperature``.
        plain: source of the resampling for the verdicts without correction.
        corrected: source of the resampling for the verdicts with the per-step ratio.

    """
    without, under = (
        check_claims(study.under(name), rng, CONCLUSIONS)
        for name, rng in ((PLAIN, plain), (RATIO, corrected))
    )
    return [Reexamined(a.claim, a.finding, b.finding) for a, b in zip(without, under, strict=True)]


def mostly_bias(strategy: str) -> Decision:
    """E[T_uncorrected − T_softmax] > 2 E[T_ratio − T_softmax] for min(T, cap), on pairs."""

    def decide(study: Study, rng: np.random.Generator) -> Finding:
        jobs = study.choices("corrections", strategy, "correction")
        plain, ratio = _need(jobs, PLAIN, strategy), _need(jobs, RATIO, strategy)
        best = study.sample(study.under(PLAIN).strategy("softmax"), "iterations")
        label = f"twice the excess of {strategy_label(strategy)} over softmax with the ratio"
        corrected = _excess(study.sample(ratio, "iterations"), best, label)
        doubled = replace(corrected, values=2 * corrected.values)
        excess = _excess(study.sample(plain, "iterations"), best, "that without")
        return smaller(study, rng, [(doubled, excess)])

    return decide


def argmax_beyond_repair(study: Study, rng: np.random.Generator) -> Finding:
    """p(argmax passes) < 80 % under every correction."""
    jobs = study.choices("corrections", "argmax", "correction")
    _need(jobs, RATIO, "argmax")
    passing = {f"argmax trials pass, {option_label('correction', n)}": o for n, o in jobs.items()}
    return all_passing(study, passing, below=rules.ALMOST_ALWAYS)


def variance_costs_more(study: Study, rng: np.random.Generator) -> Finding:
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
    return smaller(study, rng, pairs)


def hot_softmax_repaired(study: Study, rng: np.random.Generator) -> Finding:
    """At T = 1.5, p(pass) < 5 % and no trial passes without the ratio; p(pass) > 90 % with it."""
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


def every_temperature_serves(study: Study, rng: np.random.Generator) -> Finding:
    """With the gradient of μ, the pass rate is p > 90 % at every temperature."""
    grid = study.under("Behaviour").grid("temperature_grid", "temperature")
    passing = {f"trials pass at T = {t:g}": o for t, o in grid.items()}
    return all_passing(study, passing, above=rules.CONSISTENTLY)


def _need(jobs: dict[str, Outcomes], name: str, strategy: str) -> Outcomes:
    if name not in jobs:
        how = option_label("correction", name)
        raise NotMeasuredError(f"{strategy_label(strategy)} was not run with {how}")
    return jobs[name]


def _excess(a: Sample, b: Sample, label: str) -> Sample:
    """Take a − b on the common trials.

    Raises:
        NotMeasuredError: there are no common trials.

    """
    i, j = common(a.keys, b.keys)
    if len(i) == 0:
        raise NotMeasuredError(f"{a.label} and {b.label} have no trial in common")
    keys = tuple(a.keys[k] for k in i)
    return Sample(label, a.unit, a.values[i] - b.values[j], a.converged[i] & b.converged[j], keys)


CLAIMS = (
    Claim(
        id="why.epsilon_greedy_mostly_bias",
        statement="Most of the extra iterations of ε-greedy over softmax come from the bias of its"
        " gradient, not from its exploration.",
        place="experiment corrections",
        definition="The mean excess of its iterations over those of softmax (restricted to the cap,"
        " same seed and trial) falls by more than half when each action is weighted by π/μ: twice"
        " the excess with the ratio is smaller than the excess without it (paired bootstrap"
        " interval and sign-flip test).",
        decide=mostly_bias("epsilon_greedy"),
    ),
    Claim(
        id="why.decaying_mostly_bias",
        statement="Most of the extra iterations of decaying ε-greedy over softmax come from the"
        " bias of its gradient.",
        place="experiment corrections",
        definition="As for ε-greedy.",
        decide=mostly_bias("decaying_epsilon_greedy"),
    ),
    Claim(
        id="why.argmax_beyond_repair",
        statement="No correction makes argmax pass almost every time.",
        place="experiment corrections",
        definition="Argmax passes in less than 80 % of trials under every correction (Wilson"
        " intervals).",
        decide=argmax_beyond_repair,
    ),
    Claim(
        id="why.variance_costs_more",
        statement="Removing the bias entirely costs more than it gains: with per-decision or"
        " trajectory weights, both ε-greedy strategies take longer than with the per-step ratio.",
        place="experiment corrections",
        definition="The mean number of iterations, restricted to the cap, is smaller with the"
        " per-step ratio than with either kind of unbiased weights, for both strategies (paired"
        " bootstrap interval and sign-flip test).",
        decide=variance_costs_more,
    ),
    Claim(
        id="why.hot_softmax_repaired",
        statement="Softmax at temperature 1.5 never passes without correction, and passes"
        " consistently with the per-step ratio.",
        place="experiment corrections_temperature",
        definition="Without correction, no trial passes and the Wilson interval of the pass rate"
        " ends below 5 %. With the ratio, more than 90 % pass.",
        decide=hot_softmax_repaired,
    ),
    Claim(
        id="why.every_temperature_serves",
        statement="With the gradient of μ, softmax passes consistently at every temperature"
        " of the grid.",
        place="experiment corrections_temperature",
        definition="More than 90 % of trials pass at each temperature (Wilson intervals).",
        decide=every_temperature_serves,
    ),
)
"""Statements about the cause, which the thesis does not make."""
