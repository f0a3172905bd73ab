"""The statements of the thesis, each with the function that decides it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from trl_explore.statistics.bootstrap import streams
from trl_explore.thesis import means, shares
from trl_explore.thesis.rules import (
    ALMOST_ALWAYS,
    CONSISTENTLY,
    MOSTLY,
    NOT_MEASURED,
    Decision,
    Finding,
    in_iterations,
    in_seconds,
)
from trl_explore.thesis.study import NotMeasuredError, Study


@dataclass(frozen=True)
class Claim:
    """A statement of the thesis with the function that decides it.

    Attributes:
        id: unique, ``theme.statement``.
        statement: what the thesis says.
        place: where the thesis says it.
        definition: precise meaning of the statement, and the test.
        decide: (study, generator) -> finding; may raise :class:`NotMeasuredError`.

    """

    id: str
    statement: str
    place: str
    definition: str
    decide: Decision


@dataclass(frozen=True)
class Checked:
    """A claim with its finding."""

    claim: Claim
    finding: Finding


LEARNING = ("epsilon_greedy", "decaying_epsilon_greedy", "softmax")

CLAIMS: tuple[Claim, ...] = (
    # §2.3.1, §2.3.2 and §2.4.3: the grids of ε and of the decay rate
    Claim(
        id="epsilon_grid.only_0.3_passes",
        statement="Only ε = 0.3 passes almost consistently.",
        place="§2.3.1, fig. 2.1",
        definition="Almost consistently: in more than 80 % of trials. The Wilson interval of the"
        " pass rate lies above 80 % for ε = 0.3, and below 80 % for every other value of the grid.",
        decide=shares.only_one_epsilon_passes,
    ),
    Claim(
        id="decay_grid.higher_rates_pass",
        statement="The higher decay rates pass the task consistently.",
        place="§2.3.2, fig. 2.3",
        definition="Higher: above the median rate of the grid. Consistently: in more than 90 %"
        " of trials. The Wilson interval of the pass rate of each higher rate lies above 90 %.",
        decide=shares.higher_rates_pass,
    ),
    Claim(
        id="decay_grid.0.99_always_passes",
        statement="Decay rate 0.99 passes the task for all trials.",
        place="§2.3.2, fig. 2.3",
        definition="One failed trial refutes it. It holds if no trial fails and the Wilson interval"
        " of the failure rate ends below 5 %.",
        decide=shares.best_rate_always_passes,
    ),
    Claim(
        id="decay_grid.0.99_fewest_iterations",
        statement="Decay rate 0.99 has the best performance in iterations.",
        place="§2.3.2, fig. 2.2",
        definition="Its mean number of iterations, restricted to the cap of 5000, is smaller than"
        " the mean of every other rate (paired bootstrap interval and sign-flip test).",
        decide=in_iterations(means.best_rate_is_least),
    ),
    Claim(
        id="decay_grid.0.99_least_time",
        statement="Decay rate 0.99 has the best performance in time until convergence.",
        place="§2.3.2, fig. 2.4",
        definition="Its mean time until convergence or the cap, with each trial run alone, is"
        " smaller than the mean of every other rate (bootstrap interval and permutation test).",
        decide=in_seconds(means.best_rate_is_least),
    ),
    Claim(
        id="decay_grid.late_trials_never_converge",
        statement="An agent that has not converged in 1000 iterations will probably never.",
        place="§2.4.3",
        definition="Of the runs of the decay grid that have not converged at 1000 iterations,"
        " fewer than half converge by 5000 (Wilson interval). The runs of different rates share"
        " trials, so the interval uses the effective number of independent trials. Only decaying"
        " ε-greedy was run for more than 1000 iterations.",
        decide=shares.late_trials_never_converge,
    ),
    # Fig. 3.1: which strategies pass, and with which score
    Claim(
        id="score.random_never_passes",
        statement="Random never passes the task: it always takes 1000 iterations.",
        place="Results, fig. 3.1 and 3.2",
        definition="One trial that passes refutes it. It holds if no trial passes and the Wilson"
        " interval of the pass rate ends below 5 %.",
        decide=shares.never_passes("random"),
    ),
    Claim(
        id="score.random_between_20_and_25",
        statement="Random scores between 20 and 25 consistently.",
        place="Results, fig. 3.1",
        definition="Consistently: the final score of more than 90 % of trials lies in [20, 25]"
        " (Wilson interval).",
        decide=shares.random_scores_between,
    ),
    Claim(
        id="score.random_averages_25",
        statement="Random has an average score of 25.",
        place="Discussion",
        definition="The bootstrap interval of the mean final score lies within 10 % of 25, in"
        " [22.5, 27.5]. With fewer than 8 trials it is open.",
        decide=means.random_averages_25,
    ),
    Claim(
        id="score.argmax_passes_less_than_half",
        statement="Argmax passes in less than half of the trials; most take all 1000 iterations.",
        place="Results, fig. 3.1 and 3.2",
        definition="The Wilson interval of its pass rate lies below 50 %.",
        decide=shares.pass_rates("argmax", below=MOSTLY),
    ),
    Claim(
        id="score.epsilon_greedy_passes_mostly",
        statement="ε-greedy passes the task most of the time.",
        place="Results, fig. 3.1",
        definition="Most of the time: the Wilson interval of its pass rate lies above 50 %.",
        decide=shares.pass_rates("epsilon_greedy", above=MOSTLY),
    ),
    Claim(
        id="score.decaying_epsilon_greedy_passes_mostly",
        statement="Decaying ε-greedy passes the task most of the time.",
        place="Results, fig. 3.1",
        definition="Most of the time: the Wilson interval of its pass rate lies above 50 %.",
        decide=shares.pass_rates("decaying_epsilon_greedy", above=MOSTLY),
    ),
    Claim(
        id="score.epsilon_greedy_sometimes_fails",
        statement="ε-greedy has some trials that do not pass.",
        place="Results, fig. 3.1 and 3.2",
        definition="One failed trial proves it; it does not hold where none fails and the Wilson"
        " interval of failing ends below 5 %.",
        decide=shares.sometimes_fails("epsilon_greedy"),
    ),
    Claim(
        id="score.decaying_epsilon_greedy_sometimes_fails",
        statement="Decaying ε-greedy has some trials that do not pass.",
        place="Results, fig. 3.1 and 3.2; Discussion",
        definition="One failed trial proves it; it does not hold where none fails and the Wilson"
        " interval of failing ends below 5 %.",
        decide=shares.sometimes_fails("decaying_epsilon_greedy"),
    ),
    Claim(
        id="score.softmax_passes_consistently",
        statement="Softmax passes the task consistently.",
        place="Results, fig. 3.1",
        definition="Consistently: the Wilson interval of its pass rate lies above 90 %.",
        decide=shares.pass_rates("softmax", above=CONSISTENTLY),
    ),
    Claim(
        id="score.softmax_has_no_outliers",
        statement="Softmax has no outliers.",
        place="Discussion",
        definition="An outlier is a trial that does not pass, as for the other strategies. One"
        " outlier refutes it. It holds if there is none and the Wilson interval of the failure"
        " rate ends below 5 %.",
        decide=shares.never_fails("softmax"),
    ),
    Claim(
        id="score.extremes_perform_poorly",
        statement="The most extreme strategies, random and argmax, perform poorly.",
        place="Discussion",
        definition="Poorly: in less than half of the trials they pass. The Wilson intervals of"
        " both pass rates lie below 50 %.",
        decide=shares.pass_rates("random", "argmax", below=MOSTLY),
    ),
    Claim(
        id="score.others_pass_almost_every_time",
        statement="The other strategies pass the task almost every time; only a small number of"
        " their trials reaches the limit.",
        place="Results, fig. 3.2; Discussion",
        definition="Almost every time: the Wilson intervals of the pass rates of ε-greedy,"
        " decaying ε-greedy and softmax all lie above 80 %.",
        decide=shares.pass_rates(*LEARNING, above=ALMOST_ALWAYS),
    ),
    # Fig. 3.2: iterations to convergence
    Claim(
        id="iterations.argmax_needs_450",
        statement="The trials of argmax that pass take at least 450 iterations.",
        place="Results, fig. 3.2",
        definition="One trial that converges in fewer iterations refutes it. It holds if there is"
        " none and the Wilson interval of its share of the passing trials ends below 5 %.",
        decide=shares.argmax_needs_450,
    ),
    Claim(
        id="iterations.decaying_fewer_than_epsilon_greedy",
        statement="Apart from outliers, decaying ε-greedy converges in fewer iterations than"
        " ε-greedy.",
        place="Results, fig. 3.2; Discussion",
        definition="Outliers are trials that reach the cap. Over the trials (same seed and index)"
        " that converge under both strategies, the mean of decaying ε-greedy is smaller (paired"
        " bootstrap interval and sign-flip test).",
        decide=in_iterations(means.decaying_beats_constant),
    ),
    Claim(
        id="iterations.softmax_fewest",
        statement="Softmax needs the fewest iterations to converge.",
        place="Discussion",
        definition="Its mean number of iterations, restricted to the cap, is smaller than the mean"
        " of every other strategy (paired bootstrap interval and sign-flip test).",
        decide=in_iterations(means.least("softmax")),
    ),
    Claim(
        id="iterations.epsilon_greedy_most",
        statement="ε-greedy takes the most iterations of the strategies that pass.",
        place="Discussion",
        definition="The strategies that pass: ε-greedy, decaying ε-greedy and softmax. Its mean"
        " number of iterations, restricted to the cap, is larger than the means of the other two"
        " (paired bootstrap interval and sign-flip test).",
        decide=in_iterations(means.most(*LEARNING)),
    ),
    # Fig. 3.3: time of trials run alone
    Claim(
        id="time.random_least",
        statement="Random takes the least time of all: it fails the quickest.",
        place="Results, fig. 3.3",
        definition="Its mean time until convergence or the cap, with each trial run alone, is"
        " smaller than the mean of every other strategy (bootstrap interval and permutation test).",
        decide=in_seconds(means.least("random")),
    ),
    Claim(
        id="time.argmax_varies_greatly",
        statement="The time that argmax takes varies greatly.",
        place="Results, fig. 3.3",
        definition="Greatly: the standard deviation is more than half the mean (bootstrap interval"
        f" of their ratio; open with fewer than {means.MIN_FOR_BOOTSTRAP} trials).",
        decide=in_seconds(means.variation("argmax", 0.5, inf)),
    ),
    Claim(
        id="time.argmax_long_when_it_passes",
        statement="Argmax fails quickly, and takes a long time when it passes.",
        place="Results, fig. 3.3",
        definition="Its passing trials take longer on average than its failing ones (bootstrap"
        " interval and permutation test).",
        decide=in_seconds(means.argmax_long_when_it_passes),
    ),
    Claim(
        id="time.epsilon_greedies_alike",
        statement="ε-greedy and decaying ε-greedy take the same time on average.",
        place="Results, fig. 3.3",
        definition="The same: the means differ by a factor of at most 1.25. It holds if the"
        " bootstrap interval of their ratio lies in [0.8, 1.25], and does not hold if it lies"
        f" outside. With fewer than {means.MIN_FOR_BOOTSTRAP} trials it is open.",
        decide=in_seconds(means.epsilon_greedies_alike),
    ),
    Claim(
        id="time.decaying_skewed_towards_long",
        statement="The time of decaying ε-greedy has a positive skew: outliers take long.",
        place="Results, fig. 3.3",
        definition="The bootstrap interval of the skewness lies above 0."
        f" With fewer than {means.MIN_FOR_BOOTSTRAP} trials it is open.",
        decide=in_seconds(means.skewness("decaying_epsilon_greedy", 0.0, inf)),
    ),
    Claim(
        id="time.epsilon_greedy_skewed_towards_short",
        statement="The time of ε-greedy has a negative skew: outliers take little time.",
        place="Results, fig. 3.3",
        definition="The bootstrap interval of the skewness lies below 0."
        f" With fewer than {means.MIN_FOR_BOOTSTRAP} trials it is open.",
        decide=in_seconds(means.skewness("epsilon_greedy", -inf, 0.0)),
    ),
    Claim(
        id="time.softmax_least",
        statement="Softmax takes the least time to converge.",
        place="Results, fig. 3.3; Discussion",
        definition="Over the trials that converge, its mean time is smaller than the mean of every"
        " other strategy with at least one such trial (bootstrap interval and permutation test).",
        decide=in_seconds(means.least("softmax", converging=True)),
    ),
    # The hypothesis (§1.2) and the conclusion of the discussion
    Claim(
        id="conclusion.strategies_matter",
        statement="The exploration strategy has an effect on the convergence of the agent.",
        place="Discussion",
        definition="At least two of the five strategies differ in the mean number of iterations,"
        " restricted to the cap (sign-flip test with Holm's correction over all pairs). It does not"
        " hold if the intervals of all differences lie within ±5 % of the cap.",
        decide=means.strategies_matter,
    ),
    Claim(
        id="conclusion.softmax_performs_best",
        statement="Softmax performs best of the five strategies.",
        place="§1.2 (hypothesis); Discussion",
        definition="Against every other strategy, softmax converges first in more than half of the"
        " trials (Wilson interval). A trial that fails counts as later than any that converges;"
        " ties count half.",
        decide=shares.softmax_performs_best,
    ),
    # Discussion: what the thesis expects of future work
    Claim(
        id="outlook.temperature_improves",
        statement="A temperature in the softmax could improve convergence performance.",
        place="Discussion, future work",
        definition="At least one other temperature of the grid needs fewer iterations on average,"
        " restricted to the cap, than 1, the temperature of the thesis (paired bootstrap interval"
        " and sign-flip test, Bonferroni over the temperatures). It does not hold if every other"
        " temperature needs more.",
        decide=means.temperature_improves,
    ),
    Claim(
        id="outlook.baseline_drastic",
        statement="Adding a baseline could improve convergence speed drastically, whatever the"
        " strategy.",
        place="Discussion, future work",
        definition="Drastically: with at least one of the baselines, the mean number of"
        " iterations, restricted to the cap, is less than half of the mean without a"
        " baseline (bootstrap interval of the ratio, Bonferroni over the baselines), for every"
        " strategy that was run. It does not hold if, for some strategy, the intervals of all"
        " baselines lie above one half."
        f" With fewer than {means.MIN_FOR_BOOTSTRAP} trials it is open.",
        decide=means.baseline_drastic,
    ),
)


def check_claims(
    study: Study, rng: np.random.Generator, claims: Sequence[Claim] = CLAIMS
) -> list[Checked]:
    """Decide every claim on the data of a study.

    Each claim has its own random stream, so its verdict does not depend on the other claims.
    Missing data give ``not measured`` with the reason.
    """
    rngs = streams(rng, [claim.id for claim in claims])
    return [Checked(claim, _decide(claim, study, rngs[claim.id])) for claim in claims]


def _decide(claim: Claim, study: Study, rng: np.random.Generator) -> Finding:
    try:
        return claim.decide(study, rng)
    except NotMeasuredError as missing:
        return Finding(NOT_MEASURED, str(missing))
