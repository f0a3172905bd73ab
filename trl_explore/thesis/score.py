"""Fig. 3.1: which strategies pass, and with which score."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trl_explore.names import strategy_label
from trl_explore.statistics.bootstrap import bootstrap
from trl_explore.statistics.estimates import Estimate
from trl_explore.thesis import rules
from trl_explore.thesis.model import Claim, Finding
from trl_explore.thesis.study import NotMeasuredError, Study

Decision = Callable[[Study, np.random.Generator], Finding]


def passes(strategy: str, *, more_than: float) -> Decision:
    """Ask p > bound for one strategy."""
    return lambda study, rng: _rate(study, strategy, more_than)(study.level)


def never_passes(strategy: str) -> Decision:
    """No trial of a strategy passes."""

    def decide(study: Study, rng: np.random.Generator) -> Finding:
        o = study.strategy(strategy)
        what = f"{strategy_label(strategy)} trials pass"
        return rules.never(int(o.converged.sum()), len(o), what)(study.level)

    return decide


def some_fail(strategy: str) -> Decision:
    """At least one trial of a strategy does not pass."""

    def decide(study: Study, rng: np.random.Generator) -> Finding:
        o = study.strategy(strategy)
        failed = len(o) - int(o.converged.sum())
        what = f"{strategy_label(strategy)} trials fail"
        return rules.some(failed, len(o), what)(study.level)

    return decide


def none_fails(strategy: str) -> Decision:
    """No trial of a strategy fails to pass."""

    def decide(study: Study, rng: np.random.Generator) -> Finding:
        o = study.strategy(strategy)
        failed = len(o) - int(o.converged.sum())
        what = f"{strategy_label(strategy)} trials fail"
        return rules.never(failed, len(o), what)(study.level)

    return decide


def most_fail(*strategies: str) -> Decision:
    """Ask p < ½ for each of the strategies."""

    def decide(study: Study, rng: np.random.Generator) -> Finding:
        parts = []
        for name in strategies:
            o = study.strategy(name)
            count = int(o.converged.sum())
            what = f"{strategy_label(name)} trials pass"
            parts.append(rules.share_below(count, len(o), rules.MOSTLY, what))
        return rules.all_of(parts, study.level)

    return decide


def all_pass(*strategies: str, more_than: float) -> Decision:
    """Ask p > bound for each of the strategies."""
    return lambda study, rng: rules.all_of(
        [_rate(study, name, more_than) for name in strategies], study.level
    )


def random_scores_between(study: Study, rng: np.random.Generator) -> Finding:
    """Ask P(20 ≤ final score ≤ 25) > 90 %."""
    score = study.strategy("random").score
    inside = int(np.count_nonzero((score >= 20) & (score <= 25)))
    what = "random trials score 20 to 25"
    return rules.share_above(inside, len(score), rules.CONSISTENTLY, what)(study.level)


def random_averages_25(study: Study, rng: np.random.Generator) -> Finding:
    """22.5 ≤ mean final score ≤ 27.5."""
    score = study.strategy("random").score
    if not np.isfinite(score).all():
        raise NotMeasuredError("a random trial has no final score")

    def mean(level: float) -> Estimate:
        # A bootstrap without width (equal scores) would be a certainty that a few trials lack.
        e = bootstrap(_mean, [score], rng, level=level, resamples=study.resamples)
        return e if len(score) >= MIN_FOR_MEAN else Estimate(e.value, np.nan, np.nan, level)

    return rules.within(mean, len(score), 22.5, 27.5, "mean final score of random", "")(study.level)


MIN_FOR_MEAN = 8


def _mean(x: np.ndarray) -> np.ndarray:
    return x.mean(axis=-1)


def _rate(study: Study, strategy: str, bound: float) -> rules.Rule:
    o = study.strategy(strategy)
    what = f"{strategy_label(strategy)} trials pass"
    return rules.share_above(int(o.converged.sum()), len(o), bound, what)


CLAIMS = (
    Claim(
        id="score.random_never_passes",
        statement="Random never passes the task: it always takes 1000 iterations.",
        place="Results, fig. 3.1 and 3.2",
        definition="One trial that passes refutes it; it holds where none passes and the Wilson"
        " interval of passing ends below 5 %.",
        needs=("thesis/random",),
        decide=never_passes("random"),
    ),
    Claim(
        id="score.random_between_20_and_25",
        statement="Random scores between 20 and 25 consistently.",
        place="Results, fig. 3.1",
        definition="Consistently: the final score of more than 90 % of trials lies in [20, 25]"
        " (Wilson interval).",
        needs=("thesis/random",),
        decide=random_scores_between,
    ),
    Claim(
        id="score.random_averages_25",
        statement="Random has an average score of 25.",
        place="Discussion",
        definition="The bootstrap interval of the mean final score lies within 10 % of 25, in"
        " [22.5, 27.5]; fewer than 8 trials decide nothing.",
        needs=("thesis/random",),
        decide=random_averages_25,
    ),
    Claim(
        id="score.argmax_passes_less_than_half",
        statement="Argmax passes in less than half of the trials; most take all 1000 iterations.",
        place="Results, fig. 3.1 and 3.2",
        definition="The Wilson interval of its pass rate lies below 50 %.",
        needs=("thesis/argmax",),
        decide=most_fail("argmax"),
    ),
    Claim(
        id="score.epsilon_greedy_passes_mostly",
        statement="ε-greedy passes the task most of the time.",
        place="Results, fig. 3.1",
        definition="Most of the time: the Wilson interval of its pass rate lies above 50 %.",
        needs=("thesis/epsilon_greedy",),
        decide=passes("epsilon_greedy", more_than=rules.MOSTLY),
    ),
    Claim(
        id="score.decaying_epsilon_greedy_passes_mostly",
        statement="Decaying ε-greedy passes the task most of the time.",
        place="Results, fig. 3.1",
        definition="Most of the time: the Wilson interval of its pass rate lies above 50 %.",
        needs=("thesis/decaying_epsilon_greedy",),
        decide=passes("decaying_epsilon_greedy", more_than=rules.MOSTLY),
    ),
    Claim(
        id="score.epsilon_greedy_sometimes_fails",
        statement="ε-greedy has some trials that do not pass.",
        place="Results, fig. 3.1 and 3.2",
        definition="One failed trial proves it; it does not hold where none fails and the Wilson"
        " interval of failing ends below 5 %.",
        needs=("thesis/epsilon_greedy",),
        decide=some_fail("epsilon_greedy"),
    ),
    Claim(
        id="score.decaying_epsilon_greedy_sometimes_fails",
        statement="Decaying ε-greedy has some trials that do not pass.",
        place="Results, fig. 3.1 and 3.2; Discussion",
        definition="One failed trial proves it; it does not hold where none fails and the Wilson"
        " interval of failing ends below 5 %.",
        needs=("thesis/decaying_epsilon_greedy",),
        decide=some_fail("decaying_epsilon_greedy"),
    ),
    Claim(
        id="score.softmax_passes_consistently",
        statement="Softmax passes the task consistently.",
        place="Results, fig. 3.1",
        definition="Consistently: the Wilson interval of its pass rate lies above 90 %.",
        needs=("thesis/softmax",),
        decide=passes("softmax", more_than=rules.CONSISTENTLY),
    ),
    Claim(
        id="score.softmax_has_no_outliers",
        statement="Softmax has no outliers.",
        place="Discussion",
        definition="An outlier is, as for the other strategies, a trial that does not pass. One"
        " refutes it; it holds where there is none and the Wilson interval ends below 5 %.",
        needs=("thesis/softmax",),
        decide=none_fails("softmax"),
    ),
    Claim(
        id="score.extremes_perform_poorly",
        statement="The most extreme strategies, random and argmax, perform poorly.",
        place="Discussion",
        definition="Poorly: they pass in less than half of the trials. Both Wilson intervals lie"
        " below 50 %.",
        needs=("thesis/random", "thesis/argmax"),
        decide=most_fail("random", "argmax"),
    ),
    Claim(
        id="score.others_pass_almost_every_time",
        statement="The other strategies pass the task almost every time; only a small number of"
        " their trials reaches the limit.",
        place="Results, fig. 3.2; Discussion",
        definition="Almost every time: the Wilson intervals of the pass rates of ε-greedy,"
        " decaying ε-greedy and softmax all lie above 80 %.",
        needs=("thesis/epsilon_greedy", "thesis/decaying_epsilon_greedy", "thesis/softmax"),
        decide=all_pass(
            "epsilon_greedy", "decaying_epsilon_greedy", "softmax", more_than=rules.ALMOST_ALWAYS
        ),
    ),
)
