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
        place: where the thesis says it.
        statement: what the thesis says.
        definition: precise meaning of the statement, and the test.
        decide: study -> finding; may raise :class:`NotMeasuredError`.
        performance: whether it is about performance, so that it can be asked of what was learned.
    """

    id: str
    place: str
    statement: str
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
    Claim("epsilon_grid.only_0.3_passes", "§2.3.1, fig. 2.1",
          "Only ε = 0.3 passes almost consistently.",
          "Almost consistently: more than 80 % of trials pass. For ε = 0.3 more pass, for every"
          " other value of the grid fewer.", shares.only_one_epsilon_passes),
    Claim("decay_grid.higher_rates_pass", "§2.3.2, fig. 2.3",
          "The higher decay rates pass the task consistently.",
          "Higher: above the median rate of the grid. Consistently: more than 90 % of trials"
          " pass, for each of them.", shares.higher_rates_pass),
    Claim("decay_grid.0.99_always_passes", "§2.3.2, fig. 2.3",
          "Decay rate 0.99 passes the task for all trials.",
          "All: fewer than 1 % of trials fail.", shares.best_rate_always_passes),
    Claim("decay_grid.0.99_fewest_iterations", "§2.3.2, fig. 2.2",
          "Decay rate 0.99 has the best performance in iterations.",
          "Its mean number of iterations, restricted to the cap of 5000, is smaller than that of"
          " every other rate.", in_iterations(means.best_rate_is_least)),
    Claim("decay_grid.0.99_least_time", "§2.3.2, fig. 2.4",
          "Decay rate 0.99 has the best performance in time until convergence.",
          f"Its mean time is smaller than that of every other rate. {TIME}",
          in_time(means.best_rate_is_least)),
    Claim("setup.late_trials_never_converge", "§2.4.3",
          "An agent that has not converged in 1000 iterations will probably never.",
          "Of the trials that have not converged at 1000 iterations, fewer than half converge by"
          " 5000, for every strategy with at least 1 % of such trials.",
          shares.late_trials("random", "argmax", *LEARNING, below=MOSTLY)),
    # Fig. 3.1: which strategies pass, and with which score
    Claim("score.random_never_passes", "Results, fig. 3.1 and 3.2",
          "Random never passes the task: it always takes 1000 iterations.",
          "Never: fewer than 1 % of trials pass.", shares.never_passes("random")),
    Claim("score.random_between_20_and_25", "Results, fig. 3.1",
          "Random scores between 20 and 25 consistently.",
          "Consistently: the final score of more than 90 % of trials lies in [20, 25].",
          shares.random_scores_between),
    Claim("score.random_averages_25", "Discussion",
          "Random has an average score of 25.",
          "The mean final score lies within 10 % of 25, in [22.5, 27.5].",
          means.random_averages_25),
    Claim("score.argmax_passes_less_than_half", "Results, fig. 3.1 and 3.2",
          "Argmax passes in less than half of the trials; most take all 1000 iterations.",
          "Fewer than 50 % of trials pass.", shares.pass_rates("argmax", below=MOSTLY)),
    Claim("score.epsilon_greedy_passes_mostly", "Results, fig. 3.1",
          "ε-greedy passes the task most of the time.",
          "Most of the time: more than 50 % of trials pass.",
          shares.pass_rates("epsilon_greedy", above=MOSTLY)),
    Claim("score.decaying_epsilon_greedy_passes_mostly", "Results, fig. 3.1",
          "Decaying ε-greedy passes the task most of the time.",
          "Most of the time: more than 50 % of trials pass.",
          shares.pass_rates("decaying_epsilon_greedy", above=MOSTLY)),
    Claim("score.epsilon_greedy_sometimes_fails", "Results, fig. 3.1 and 3.2",
          "ε-greedy has some trials that do not pass.",
          SOME_FAIL, shares.sometimes_fails("epsilon_greedy")),
    Claim("score.decaying_epsilon_greedy_sometimes_fails", "Results, fig. 3.1 and 3.2; Discussion",
          "Decaying ε-greedy has some trials that do not pass.",
          SOME_FAIL, shares.sometimes_fails("decaying_epsilon_greedy")),
    Claim("score.softmax_passes_consistently", "Results, fig. 3.1",
          "Softmax passes the task consistently.",
          "Consistently: more than 90 % of trials pass.",
          shares.pass_rates("softmax", above=CONSISTENTLY)),
    Claim("score.softmax_has_no_outliers", "Discussion",
          "Softmax has no outliers.",
          "An outlier is a trial that does not pass, as for the other strategies. None: fewer"
          " than 1 % of trials.", shares.never_fails("softmax")),
    Claim("score.extremes_perform_poorly", "Discussion",
          "The most extreme strategies, random and argmax, perform poorly.",
          "Poorly: fewer than 50 % of trials pass, under each of the two.",
          shares.pass_rates("random", "argmax", below=MOSTLY)),
    Claim("score.others_pass_almost_every_time", "Results, fig. 3.2; Discussion",
          "The other strategies pass the task almost every time; only a small number of their"
          " trials reaches the limit.",
          "Almost every time: more than 80 % of trials pass, under each of ε-greedy, decaying"
          " ε-greedy and softmax.", shares.pass_rates(*LEARNING, above=ALMOST_ALWAYS)),
    # Fig. 3.2: iterations to convergence
    Claim("iterations.argmax_needs_450", "Results, fig. 3.2",
          "The trials of argmax that pass take at least 450 iterations.",
          "Fewer than 1 % of the trials that pass do so in fewer iterations.",
          shares.argmax_needs_450),
    Claim("iterations.decaying_fewer_than_epsilon_greedy", "Results, fig. 3.2; Discussion",
          "Apart from outliers, decaying ε-greedy converges in fewer iterations than ε-greedy.",
          "Outliers are trials that reach the cap. Over the trials (same seed and index) that"
          " converge under both strategies, the mean of decaying ε-greedy is smaller.",
          in_iterations(means.decaying_beats_constant)),
    Claim("iterations.softmax_fewest", "Discussion",
          "Softmax needs the fewest iterations to converge.",
          "Its mean number of iterations, restricted to the cap, is smaller than that of every"
          " other strategy.", in_iterations(means.least("softmax"))),
    Claim("iterations.epsilon_greedy_most", "Discussion",
          "ε-greedy takes the most iterations of the strategies that pass.",
          "The strategies that pass: ε-greedy, decaying ε-greedy and softmax. Its mean number of"
          " iterations, restricted to the cap, is larger than those of the other two.",
          in_iterations(means.most(*LEARNING))),
    # Fig. 3.3: time
    Claim("time.random_least", "Results, fig. 3.3",
          "Random takes the least time of all: it fails the quickest.",
          f"Its mean time is smaller than that of every other strategy. {TIME}",
          in_time(means.least("random"))),
    Claim("time.argmax_varies_greatly", "Results, fig. 3.3",
          "The time that argmax takes varies greatly.",
          "Greatly: the upper quartile of the times is more than twice the lower quartile, as for"
          " a normal distribution whose standard deviation is half its mean (exact intervals of"
          f" the quantiles). {TIME}", in_time(means.varies_greatly("argmax"))),
    Claim("time.argmax_long_when_it_passes", "Results, fig. 3.3",
          "Argmax fails quickly, and takes a long time when it passes.",
          f"Its passing trials take longer on average than its failing ones. {TIME}",
          in_time(means.argmax_long_when_it_passes)),
    Claim("time.epsilon_greedies_alike", "Results, fig. 3.3",
          "ε-greedy and decaying ε-greedy take the same time on average.",
          f"The same: the means differ by a factor of at most 1.25. {TIME}",
          in_time(means.epsilon_greedies_alike)),
    Claim("time.decaying_skewed_towards_long", "Results, fig. 3.3",
          "The time of decaying ε-greedy has a positive skew: outliers take long.",
          "The 90 % quantile is further from the median than the 10 % quantile (exact intervals"
          f" of the quantiles). {TIME}", in_time(means.skewed("decaying_epsilon_greedy", 1.0))),
    Claim("time.epsilon_greedy_skewed_towards_short", "Results, fig. 3.3",
          "The time of ε-greedy has a negative skew: outliers take little time.",
          "The 10 % quantile is further from the median than the 90 % quantile (exact intervals"
          f" of the quantiles). {TIME}", in_time(means.skewed("epsilon_greedy", -1.0))),
    Claim("time.softmax_least", "Results, fig. 3.3; Discussion",
          "Softmax takes the least time to converge.",
          "Over the trials that converge, its mean time is smaller than that of every other"
          f" strategy with at least one such trial. {TIME}",
          in_time(means.least("softmax", converging=True))),
    # The hypothesis (§1.2) and the conclusion of the discussion
    Claim("conclusion.strategies_matter", "Discussion",
          "The exploration strategy has an effect on the convergence of the agent.",
          "At least two of the five strategies differ in the mean number of iterations,"
          " restricted to the cap (Holm's correction over all pairs). It does not hold if the"
          " intervals of all differences lie within ±5 % of the cap.", means.strategies_matter),
    Claim("conclusion.softmax_performs_best", "§1.2 (hypothesis); Discussion",
          "Softmax performs best of the five strategies.",
          "Against every other strategy, softmax converges first in more than half of the trials"
          " (Wilson interval). A trial that fails counts as later than any that converges; ties"
          " count half.", shares.softmax_performs_best),
    # Discussion: the mechanisms that the thesis suspects
    Claim("mechanism.epsilon_greedy_never_optimal", "Discussion",
          "Even with enough experience, ε-greedy is still forced to explore, and so never becomes"
          " fully optimal.",
          "The final policies of its trials score more without the strategy than with it (learned"
          " score against final score of the same trials).",
          means.exploring_costs_score("epsilon_greedy"), performance=False),
    Claim("mechanism.argmax_remains_stuck", "Discussion",
          "Without exploration, argmax remains stuck in suboptimal policies.",
          "Of its trials that have not converged at 1000 iterations, fewer than 10 % converge by"
          " 5000.", shares.late_trials("argmax", below=1 - CONSISTENTLY)),
    Claim("mechanism.decaying_outliers_stuck", "Discussion",
          "The outliers of decaying ε-greedy explored too little before the phase in which it"
          " only exploits.",
          "If so, they are stuck as argmax is: of its trials that have not converged at 1000"
          " iterations, fewer than 10 % converge by 5000.",
          shares.late_trials("decaying_epsilon_greedy", below=1 - CONSISTENTLY)),
    Claim("mechanism.preferred_beats_uniform", "§1.2; Discussion",
          "Softmax is quicker because it explores by preference, not uniformly.",
          "If so, it is quicker where the gradient of every strategy is corrected: with the"
          " per-step ratio, its mean number of iterations, restricted to the cap, is smaller than"
          " those of ε-greedy and decaying ε-greedy.", means.preferred_beats_uniform),
    # Discussion: what the thesis expects of future work
    Claim("outlook.temperature_improves", "Discussion, future work",
          "A temperature in the softmax could improve convergence performance.",
          "In the program of the thesis (appendix A.1 and A.3) the agent acts by and learns from"
          " the same softmax, so a temperature changes both (correction=behaviour). At least one"
          " other temperature of the grid needs fewer iterations on average, restricted to the"
          " cap, than 1 (Bonferroni over the temperatures). It does not hold if every other"
          " temperature needs more.", means.temperature_improves),
    Claim("outlook.acting_temperature_improves", "Discussion, future work (another reading)",
          "A temperature at which the agent acts, but does not learn, could improve convergence"
          " performance.",
          "As for the temperature of both, with the gradient of the softmax at 1.",
          means.acting_temperature_improves),
    Claim("outlook.baseline_drastic", "Discussion, future work",
          "Adding a baseline could improve convergence speed drastically, whatever the strategy.",
          "Drastically: with at least one of the baselines, the mean number of iterations beyond"
          " the first full window of 100 episodes, before which no trial can pass, is less than"
          " half of that without a baseline (Bonferroni over the baselines), for every strategy"
          " that was run. It does not hold if, for some strategy, no baseline does so.",
          means.baseline_drastic),
)  # fmt: skip


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
