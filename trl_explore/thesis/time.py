"""Fig. 3.3: time by strategy, of trials run by themselves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from trl_explore.names import strategy_label
from trl_explore.statistics.bootstrap import bootstrap
from trl_explore.statistics.estimates import Estimate
from trl_explore.thesis import rules
from trl_explore.thesis.model import OPEN, Claim, Finding
from trl_explore.thesis.rules import TimeDecision, with_frames
from trl_explore.thesis.study import STRATEGIES, Sample, Study

# Below this the bootstrap of a ratio, a spread or a skewness says little about its error.
MIN_FOR_SHAPE = 8
SAME = 1.25
GREAT_VARIATION = 0.5


def random_takes_least(study: Study, rng: np.random.Generator, unit: str) -> Finding:
    """mean(random) < mean(other) for every other strategy, all trials."""
    samples = {n: study.sample(study.strategy(n), unit) for n in STRATEGIES}
    first = samples.pop("random")
    return rules.all_of(
        [rules.mean_less(first, s, rng, resamples=study.resamples) for s in samples.values()],
        study.level,
    )


def softmax_takes_least(study: Study, rng: np.random.Generator, unit: str) -> Finding:
    """mean(softmax) < mean(other) over the trials that converge, for all that converge at all."""
    samples = {n: study.sample(study.strategy(n), unit) for n in STRATEGIES}
    converging = {n: s.only(s.converged) for n, s in samples.items()}
    best = converging.pop("softmax")
    others = [s for s in converging.values() if len(s) > 0]
    if len(best) == 0 or not others:
        return Finding(OPEN, "no trials of softmax, or none of the others, converge")
    return rules.all_of(
        [rules.mean_less(best, s, rng, resamples=study.resamples) for s in others], study.level
    )


def argmax_varies_greatly(study: Study, rng: np.random.Generator, unit: str) -> Finding:
    """Ask sd / mean > ½."""
    s = study.sample(study.strategy("argmax"), unit)
    what = "sd / mean of argmax"
    return _shape(variation, [s], (GREAT_VARIATION, np.inf), what, study, rng)


def argmax_long_when_it_passes(study: Study, rng: np.random.Generator, unit: str) -> Finding:
    """mean(failing argmax trials) < mean(passing ones)."""
    s = study.sample(study.strategy("argmax"), unit)
    failing = s.only(~s.converged, "failing argmax")
    passing = s.only(s.converged, "passing argmax")
    return rules.mean_less(failing, passing, rng, resamples=study.resamples)(study.level)


def epsilon_greedies_alike(study: Study, rng: np.random.Generator, unit: str) -> Finding:
    """4/5 ≤ mean(decaying) / mean(constant) ≤ 5/4."""
    both = [
        study.sample(study.strategy(n), unit) for n in ("decaying_epsilon_greedy", "epsilon_greedy")
    ]
    what = "mean of decaying ε-greedy over mean of ε-greedy"
    return _shape(ratio_of_means, both, (1 / SAME, SAME), what, study, rng)


def skewed(strategy: str, bounds: tuple[float, float]) -> TimeDecision:
    """Ask whether the skewness of a strategy's time lies in ``bounds``, a half-line from 0."""

    def decide(study: Study, rng: np.random.Generator, unit: str) -> Finding:
        s = study.sample(study.strategy(strategy), unit)
        return _shape(skewness, [s], bounds, f"skewness of {strategy_label(strategy)}", study, rng)

    return decide


def variation(x: np.ndarray) -> Any:
    """Coefficient of variation s / x̄ over the last axis."""
    return x.std(axis=-1, ddof=1) / x.mean(axis=-1)


def ratio_of_means(x: np.ndarray, y: np.ndarray) -> Any:
    """x̄ / ȳ over the last axis."""
    return x.mean(axis=-1) / y.mean(axis=-1)


def skewness(x: np.ndarray) -> Any:
    """m₃ / m₂^(3/2) over the last axis; NaN where all values are equal."""
    d = x - x.mean(axis=-1, keepdims=True)
    m2, m3 = (d**2).mean(axis=-1), (d**3).mean(axis=-1)
    # Equal values leave a rounding error in m2, not 0.
    flat = m2 <= (1e-12 * x.mean(axis=-1)) ** 2
    return np.where(flat, np.nan, m3 / np.where(flat, 1.0, m2) ** 1.5)


def _shape(
    statistic: Callable[..., Any],
    samples: list[Sample],
    bounds: tuple[float, float],
    what: str,
    study: Study,
    rng: np.random.Generator,
) -> Finding:
    if len(samples) == 2:
        x, y, paired = rules.align(*samples)
        arrays = [x, y]
    else:
        arrays, paired = [samples[0].values], False
    n = min(len(a) for a in arrays)
    if n < MIN_FOR_SHAPE:
        return Finding(OPEN, f"{what}: {n} trials, at least {MIN_FOR_SHAPE} are needed")

    def estimate(level: float) -> Estimate:
        return bootstrap(
            statistic, arrays, rng, paired=paired, level=level, resamples=study.resamples
        )

    return rules.within(estimate, n, *bounds, what, "")(study.level)


CLAIMS = (
    Claim(
        id="time.random_least",
        statement="Random takes the least time of all: it fails the quickest.",
        place="Results, fig. 3.3",
        definition="Its mean time, trials run by themselves until convergence or the cap, is"
        " smaller than that of each other strategy (bootstrap interval and permutation test).",
        needs=(*(f"thesis/{name}" for name in STRATEGIES), "seconds"),
        decide=with_frames(random_takes_least),
    ),
    Claim(
        id="time.argmax_varies_greatly",
        statement="The time that argmax takes varies greatly.",
        place="Results, fig. 3.3",
        definition="Greatly: the standard deviation is more than half the mean (bootstrap interval"
        f" of their ratio; fewer than {MIN_FOR_SHAPE} trials decide nothing).",
        needs=("thesis/argmax", "seconds"),
        decide=with_frames(argmax_varies_greatly),
    ),
    Claim(
        id="time.argmax_long_when_it_passes",
        statement="Argmax fails quickly, and takes a long time when it passes.",
        place="Results, fig. 3.3",
        definition="Its passing trials take longer on average than its failing ones (bootstrap"
        " interval and permutation test).",
        needs=("thesis/argmax", "seconds"),
        decide=with_frames(argmax_long_when_it_passes),
    ),
    Claim(
        id="time.epsilon_greedies_alike",
        statement="ε-greedy and decaying ε-greedy take the same time on average.",
        place="Results, fig. 3.3",
        definition="The same: the means differ by a factor of at most 1.25. It holds where the"
        " bootstrap interval of their ratio lies in [0.8, 1.25], and not where it lies outside;"
        f" fewer than {MIN_FOR_SHAPE} trials decide nothing.",
        needs=("thesis/epsilon_greedy", "thesis/decaying_epsilon_greedy", "seconds"),
        decide=with_frames(epsilon_greedies_alike),
    ),
    Claim(
        id="time.decaying_skewed_towards_long",
        statement="The time of decaying ε-greedy has a positive skew: outliers take long.",
        place="Results, fig. 3.3",
        definition="The bootstrap interval of the skewness lies above 0;"
        f" fewer than {MIN_FOR_SHAPE} trials decide nothing.",
        needs=("thesis/decaying_epsilon_greedy", "seconds"),
        decide=with_frames(skewed("decaying_epsilon_greedy", (0.0, np.inf))),
    ),
    Claim(
        id="time.epsilon_greedy_skewed_towards_short",
        statement="The time of ε-greedy has a negative skew: outliers take little time.",
        place="Results, fig. 3.3",
        definition="The bootstrap interval of the skewness lies below 0;"
        f" fewer than {MIN_FOR_SHAPE} trials decide nothing.",
        needs=("thesis/epsilon_greedy", "seconds"),
        decide=with_frames(skewed("epsilon_greedy", (-np.inf, 0.0))),
    ),
    Claim(
        id="time.softmax_least",
        statement="Softmax takes the least time to converge.",
        place="Results, fig. 3.3; Discussion",
        definition="Over the trials that converge, its mean time is smaller than that of each"
        " other strategy of which any trial converges (bootstrap interval and permutation test).",
        needs=(*(f"thesis/{name}" for name in STRATEGIES), "seconds"),
        decide=with_frames(softmax_takes_least),
    ),
)
