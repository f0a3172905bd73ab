"""The statements of the thesis, each with the function that decides it.

Shares of trials are decided by their exact interval, means by the interval of their difference, as
``rules`` describes. Each definition is true or false whatever the number of trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from trl_explore.thesis import means, shares
from trl_explore.thesis.rules import (
    ALMOST_ALWAYS,
    CONSISTENTLY,
    FAILS,
    HOLDS,
    MOSTLY,
    NOT_MEASURED,
    OPEN,
    Decision,
    Finding,
    in_iterations,
    in_time,
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
        decide: study -> finding; may raise :class:`NotMeasuredError`.
        performance: whether it is about performance, so that it can be asked of what was learned.

    """

    id: str
    statement: str
    place: str
    definition: str
    decide: Decision
    performance: bool = True


@dataclass(frozen=True)
class Checked:
    """A claim with its finding, and its finding for what was learned.

    ``learned`` is the verdict of the same function on the same trials, judged by the policy without
    the strategy; None if the claim is not about performance.
    """

    claim: Claim
    finding: Finding
    learned: Finding | None = None

    @property
    def twin(self) -> str:
        """Both verdicts in words, for example "holds as measured; open for what was learned"."""
        if self.learned is None or NOT_MEASURED in (self.finding.verdict, self.learned.verdict):
            return ""
        words = {HOLDS: "holds", FAILS: "does not hold", OPEN: "is open"}
        first, second = words[self.finding.verdict], words[self.learned.verdict]
        if first == second:
            return f"{first} as measured, and for what was learned"
        return f"{first} as measured; {second} for what was learned"


LEARNING = ("epsilon_greedy", "decaying_epsilon_greedy", "softmax")
SOME_FAIL = (
    "Some: more than 1 % of trials do not pass. It does not hold if fewer than 1 % do not pass."
)
TIME = "Time: frames plus a cost of each iteration, from the start to convergence or the cap."

CLAIMS: tuple[Claim, ...] = (
    # §2.3.1 and §2.3.2: the grids of ε and of the decay rate
    Claim(
        id="epsilon_grid.only_0.3_passes",
        statement="Only ε = 0.3 passes almost consistently.",
        place="§2.3.1, fig. 2.1",
        definition="Almost consistently: more than 80 % of trials pass. For ε = 0.3 more pass, for"
        " every other value of the grid fewer.",
        decide=shares.only_one_epsilon_passes,
    ),
    Claim(
        id="decay_grid.higher_rates_pass",
        statement="The higher decay rates pass the task consistently.",
        place="§2.3.2, fig. 2.3",
        definition="Higher: above the median rate of the grid. Consistently: more than 90 % of"
        " trials pass, for each of them.",
        decide=shares.higher_rates_pass,
    ),
    Claim(
        id="decay_grid.0.99_always_passes",
        statement="Decay rate 0.99 passes the task for all trials.",
        place="§2.3.2, fig. 2.3",
        definition="All: fewer than 1 % of trials fail.",
        decide=shares.best_rate_always_passes,
    ),
    Claim(
        id="decay_grid.0.99_fewest_iterations",
        statement="Decay rate 0.99 has the best performance in iterations.",
        place="§2.3.2, fig. 2.2",
        definition="Its mean number of iterations, restricted to the cap of 5000, is smaller than"
        " that of every other rate.",
        decide=in_iterations(means.best_rate_is_least),
    ),
    Claim(
        id="decay_grid.0.99_least_time",
        statement="Decay rate 0.99 has the best performance in time until convergence.",
        place="§2.3.2, fig. 2.4",
        definition=f"Its mean time is smaller than that of every other rate. {TIME}",
        decide=in_time(means.best_rate_is_least),
    ),
    Claim(
        id="setup.late_trials_never_converge",
        statement="An agent that has not converged in 1000 iterations will probably never.",
        place="§2.4.3",
        definition="Of the trials that have not converged at 1000 iterations, fewer than half"
        " converge by 5000, for every strategy with at least 1 % of such trials.",
        decide=shares.late_trials("random", "argmax", *LEARNING, below=MOSTLY),
    ),
    # Fig. 3.1: which strategies pass, and with which score
    Claim(
        id="score.random_never_passes",
        statement="Random never passes the task: it always takes 1000 iterations.",
        place="Results, fig. 3.1 and 3.2",
        definition="Never: fewer than 1 % of trials pass.",
        decide=shares.never_passes("random"),
    ),
    Claim(
        id="score.random_between_20_and_25",
        statement="Random scores between 20 and 25 consistently.",
        place="Results, fig. 3.1",
        definition="Consistently: the final score of more than 90 % of trials lies in [20, 25].",
        decide=shares.random_scores_between,
    ),
    Claim(
        id="score.random_averages_25",
        statement="Random has an average score of 25.",
        place="Discussion",
        definition="The mean final score lies within 10 % of 25, in [22.5, 27.5].",
        decide=means.random_averages_25,
    ),
    Claim(
        id="score.argmax_passes_less_than_half",
        statement="Argmax passes in less than half of the trials; most take all 1000 iterations.",
        place="Results, fig. 3.1 and 3.2",
        definition="Fewer than 50 % of trials pass.",
        decide=shares.pass_rates("argmax", below=MOSTLY),
    ),
    Claim(
        id="score.epsilon_greedy_passes_mostly",
        statement="ε-greedy passes the task most of the time.",
        place="Results, fig. 3.1",
        definition="Most of the time: more than 50 % of trials pass.",
        decide=shares.pass_rates("epsilon_greedy", above=MOSTLY),
    ),
    Claim(
        id="score.decaying_epsilon_greedy_passes_mostly",
        statement="Decaying ε-greedy passes the task most of the time.",
        place="Results, fig. 3.1",
        definition="Most of the time: more than 50 % of trials pass.",
        decide=shares.pass_rates("decaying_epsilon_greedy", above=MOSTLY),
    ),
    Claim(
        id="score.epsilon_greedy_sometimes_fails",
        statement="ε-greedy has some trials that do not pass.",
        place="Results, fig. 3.1 and 3.2",
        definition=SOME_FAIL,
        decide=shares.sometimes_fails("epsilon_greedy"),
    ),
    Claim(
        id="score.decaying_epsilon_greedy_sometimes_fails",
        statement="Decaying ε-greedy has some trials that do not pass.",
        place="Results, fig. 3.1 and 3.2; Discussion",
        definition=SOME_FAIL,
        decide=shares.sometimes_fails("decaying_epsilon_greedy"),
    ),
    Claim(
        id="score.softmax_passes_consistently",
        statement="Softmax passes the task consistently.",
        place="Results, fig. 3.1",
        definition="Consistently: more than 90 % of trials pass.",
        decide=shares.pass_rates("softmax", above=CONSISTENTLY),
    ),
    Claim(
        id="score.softmax_has_no_outliers",
        statement="Softmax has no outliers.",
        place="Discussion",
        definition="An outlier is a trial that does not pass, as for the other strategies. None:"
        " fewer than 1 % of trials.",
        decide=shares.never_fails("softmax"),
    ),
    Claim(
        id="score.extremes_perform_poorly",
        statement="The most extreme strategies, random and argmax, perform poorly.",
        place="Discussion",
        definition="Poorly: fewer than 50 % of trials pass, under each of the two.",
        decide=shares.pass_rates("random", "argmax", below=MOSTLY),
    ),
    Claim(
        id="score.others_pass_almost_every_time",
        statement="The other strategies pass the task almost every time; only a small number of"
        " their trials reaches the limit.",
        place="Results, fig. 3.2; Discussion",
        definition="Almost every time: more than 80 % of trials pass, under each of ε-greedy,"
        " decaying ε-greedy and softmax.",
        decide=shares.pass_rates(*LEARNING, above=ALMOST_ALWAYS),
    ),
    # Fig. 3.2: iterations to convergence
    Claim(
        id="iterations.argmax_needs_450",
        statement="The trials of argmax that pass take at least 450 iterations.",
        place="Results, fig. 3.2",
        definition="Fewer than 1 % of the trials that pass do so in fewer iterations.",
        decide=shares.argmax_needs_450,
    ),
    Claim(
        id="iterations.decaying_fewer_than_epsilon_greedy",
        statement="Apart from outliers, decaying ε-greedy converges in fewer iterations than"
        " ε-greedy.",
        place="Results, fig. 3.2; Discussion",
        definition="Outliers are trials that reach the cap. Over the trials (same seed and index)"
        " that converge under both strategies, the mean of decaying ε-greedy is smaller.",
        decide=in_iterations(means.decaying_beats_constant),
    ),
    Claim(
        id="iterations.softmax_fewest",
        statement="Softmax needs the fewest iterations to converge.",
        place="Discussion",
        definition="Its mean number of iterations, restricted to the cap, is smaller than that of"
        " every other strategy.",
        decide=in_iterations(means.least("softmax")),
    ),
    Claim(
        id="iterations.epsilon_greedy_most",
        statement="ε-greedy takes the most iterations of the strategies that pass.",
        place="Discussion",
        definition="The strategies that pass: ε-greedy, decaying ε-greedy and softmax. Its mean"
        " number of iterations, restricted to the cap, is larger than those of the other two.",
        decide=in_iterations(means.most(*LEARNING)),
    ),
    # Fig. 3.3: time
    Claim(
        id="time.random_least",
        statement="Random takes the least time of all: it fails the quickest.",
        place="Results, fig. 3.3",
        definition=f"Its mean time is smaller than that of every other strategy. {TIME}",
        decide=in_time(means.least("random")),
    ),
    Claim(
        id="time.argmax_varies_greatly",
        statement="The time that argmax takes varies greatly.",
        place="Results, fig. 3.3",
        definition="Greatly: the upper quartile of the times is more than twice the lower quartile,"
        " as for a normal distribution whose standard deviation is half its mean (exact intervals"
        f" of the quantiles). {TIME}",
        decide=in_time(means.varies_greatly("argmax")),
    ),
    Claim(
        id="time.argmax_long_when_it_passes",
        statement="Argmax fails quickly, and takes a long time when it passes.",
        place="Results, fig. 3.3",
        definition=f"Its passing trials take longer on average than its failing ones. {TIME}",
        decide=in_time(means.argmax_long_when_it_passes),
    ),
    Claim(
        id="time.epsilon_greedies_alike",
        statement="ε-greedy and decaying ε-greedy take the same time on average.",
        place="Results, fig. 3.3",
        definition=f"The same: the means differ by a factor of at most 1.25. {TIME}",
        decide=in_time(means.epsilon_greedies_alike),
    ),
    Claim(
        id="time.decaying_skewed_towards_long",
        statement="The time of decaying ε-greedy has a positive skew: outliers take long.",
        place="Results, fig. 3.3",
        definition="The 90 % quantile is further from the median than the 10 % quantile (exact"
        f" intervals of the quantiles). {TIME}",
        decide=in_time(means.skewed("decaying_epsilon_greedy", 1.0)),
    ),
    Claim(
        id="time.epsilon_greedy_skewed_towards_short",
        statement="The time of ε-greedy has a negative skew: outliers take little time.",
        place="Results, fig. 3.3",
        definition="The 10 % quantile is further from the median than the 90 % quantile (exact"
        f" intervals of the quantiles). {TIME}",
        decide=in_time(means.skewed("epsilon_greedy", -1.0)),
    ),
    Claim(
        id="time.softmax_least",
        statement="Softmax takes the least time to converge.",
        place="Results, fig. 3.3; Discussion",
        definition="Over the trials that converge, its mean time is smaller than that of every"
        f" other strategy with at least one such trial. {TIME}",
        decide=in_time(means.least("softmax", converging=True)),
    ),
    # The hypothesis (§1.2) and the conclusion of the discussion
    Claim(
        id="conclusion.strategies_matter",
        statement="The exploration strategy has an effect on the convergence of the agent.",
        place="Discussion",
        definition="At least two of the five strategies differ in the mean number of iterations,"
        " restricted to the cap (Holm's correction over all pairs). It does not hold if the"
        " intervals of all differences lie within ±5 % of the cap.",
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
    # Discussion: the mechanisms that the thesis suspects
    Claim(
        id="mechanism.epsilon_greedy_never_optimal",
        statement="Even with enough experience, ε-greedy is still forced to explore, and so never"
        " becomes fully optimal.",
        place="Discussion",
        definition="The final policies of its trials score more without the strategy than with it"
        " (learned score against final score of the same trials).",
        decide=means.exploring_costs_score("epsilon_greedy"),
        performance=False,
    ),
    Claim(
        id="mechanism.argmax_remains_stuck",
        statement="Without exploration, argmax remains stuck in suboptimal policies.",
        place="Discussion",
        definition="Of its trials that have not converged at 1000 iterations, fewer than 10 %"
        " converge by 5000.",
        decide=shares.late_trials("argmax", below=1 - CONSISTENTLY),
    ),
    Claim(
        id="mechanism.decaying_outliers_stuck",
        statement="The outliers of decaying ε-greedy explored too little before the phase in which"
        " it only exploits.",
        place="Discussion",
        definition="If so, they are stuck as argmax is: of its trials that have not converged at"
        " 1000 iterations, fewer than 10 % converge by 5000.",
        decide=shares.late_trials("decaying_epsilon_greedy", below=1 - CONSISTENTLY),
    ),
    Claim(
        id="mechanism.preferred_beats_uniform",
        statement="Softmax is quicker because it explores by preference, not uniformly.",
        place="§1.2; Discussion",
        definition="If so, it is quicker where the gradient of every strategy is corrected: with"
        " the per-step ratio, its mean number of iterations, restricted to the cap, is smaller"
        " than those of ε-greedy and decaying ε-greedy.",
        decide=means.preferred_beats_uniform,
    ),
    # Discussion: what the thesis expects of future work
    Claim(
        id="outlook.temperature_improves",
        statement="A temperature in the softmax could improve convergence performance.",
        place="Discussion, future work",
        definition="In the program of the thesis (appendix A.1 and A.3) the agent acts by and"
        " learns from the same softmax, so a temperature changes both (correction=behaviour). At"
        " least one other temperature of the grid needs fewer iterations on average, restricted to"
        " the cap, than 1 (Bonferroni over the temperatures). It does not hold if every other"
        " temperature needs more.",
        decide=means.temperature_improves,
    ),
    Claim(
        id="outlook.acting_temperature_improves",
        statement="A temperature at which the agent acts, but does not learn, could improve"
        " convergence performance.",
        place="Discussion, future work (another reading)",
        definition="As for the temperature of both, with the gradient of the softmax at 1.",
        decide=means.acting_temperature_improves,
    ),
    Claim(
        id="outlook.baseline_drastic",
        statement="Adding a baseline could improve convergence speed drastically, whatever the"
        " strategy.",
        place="Discussion, future work",
        definition="Drastically: with at least one of the baselines, the mean number of iterations"
        " beyond the first full window of 100 episodes, before which no trial can pass, is less"
        " than half of that without a baseline (Bonferroni over the baselines), for every strategy"
        " that was run. It does not hold if, for some strategy, no baseline does so.",
        decide=means.baseline_drastic,
    ),
)


def check_claims(study: Study, claims: Sequence[Claim] = CLAIMS) -> list[Checked]:
    """Decide every claim on the data of a study, as measured and for what was learned.

    Missing data give ``not measured`` with the reason.
    """
    measured, learned = study.judged("passed"), study.judged("learned")
    return [
        Checked(c, _decide(c, measured), _decide(c, learned) if c.performance else None)
        for c in claims
    ]


def _decide(claim: Claim, study: Study) -> Finding:
    try:
        return claim.decide(study)
    except NotMeasuredError as missing:
        return Finding(NOT_MEASURED, str(missing))
