"""Discussion: what the thesis expects of future work."""

from __future__ import annotations

import numpy as np

from trl_explore.names import option_label, strategy_label
from trl_explore.statistics.bootstrap import bootstrap
from trl_explore.statistics.estimates import Estimate
from trl_explore.thesis import rules
from trl_explore.thesis.model import OPEN, Claim, Finding
from trl_explore.thesis.study import NotMeasuredError, Sample, Study
from trl_explore.thesis.time import MIN_FOR_SHAPE, ratio_of_means

DRASTICALLY = 0.5
THESIS_TEMPERATURE = 1.0


def temperature_improves(study: Study, rng: np.random.Generator) -> Finding:
    """mean(T) < mean(1) for at least one other temperature T of the grid."""
    grid = study.grid("temperature_grid", "temperature")
    samples = {t: study.sample(o, "iterations", f"(T = {t:g})") for t, o in grid.items()}
    plain = samples.pop(THESIS_TEMPERATURE, None)
    if plain is None or not samples:
        raise NotMeasuredError("the grid needs the temperature 1 and at least one other")
    return rules.any_of(
        [rules.mean_less(s, plain, rng, resamples=study.resamples) for s in samples.values()]
    )(study.level)


def baseline_drastic(study: Study, rng: np.random.Generator) -> Finding:
    """mean(some baseline) < ½ mean(none), for every strategy."""
    parts = []
    for strategy in dict.fromkeys(o.strategy for o in study.experiment("baselines")):
        jobs = study.choices("baselines", strategy, "baseline")
        samples = {
            name: study.sample(
                o, "iterations", f"{strategy_label(strategy)} with {option_label('baseline', name)}"
            )
            for name, o in jobs.items()
        }
        plain = samples.pop("Constant", None)
        if plain is None or not samples:
            raise NotMeasuredError(
                f"{strategy_label(strategy)} was not run both without and with a baseline"
            )
        parts.append(
            rules.any_of([ratio_below(s, plain, DRASTICALLY, study, rng) for s in samples.values()])
        )
    return rules.all_of(parts, study.level)


def ratio_below(
    a: Sample, b: Sample, bound: float, study: Study, rng: np.random.Generator
) -> rules.Rule:
    """mean(a) < bound · mean(b), by the bootstrap interval of the ratio."""
    x, y, paired = rules.align(a, b)
    what = f"mean of {a.label} over that of {b.label}"
    n = min(len(x), len(y))

    def estimate(level: float) -> Estimate:
        return bootstrap(
            ratio_of_means, [x, y], rng, paired=paired, level=level, resamples=study.resamples
        )

    if n < MIN_FOR_SHAPE:
        return lambda level: Finding(
            OPEN, f"{what}: {n} trials, at least {MIN_FOR_SHAPE} are needed"
        )
    return rules.within(estimate, n, 0.0, bound, what, "")


CLAIMS = (
    Claim(
        id="outlook.temperature_improves",
        statement="A temperature in the softmax could improve convergence performance.",
        place="Discussion, future work",
        definition="At least one temperature of the grid other than 1, which the thesis used, needs"
        " fewer iterations on average, restricted to the cap (paired bootstrap interval and"
        " sign-flip test, Bonferroni over the temperatures). It does not hold where every other"
        " temperature needs more.",
        needs=("temperature_grid",),
        decide=temperature_improves,
    ),
    Claim(
        id="outlook.baseline_drastic",
        statement="Adding a baseline could improve convergence speed drastically, whatever the"
        " strategy.",
        place="Discussion, future work",
        definition="Drastically: with at least one of the baselines, the mean number of"
        " iterations, restricted to the cap, is less than half of that without (bootstrap interval"
        " of the ratio, Bonferroni over the baselines), for every strategy that was run. It does"
        " not hold where, for some strategy, the intervals of all baselines lie above one half;"
        f" fewer than {MIN_FOR_SHAPE} trials decide nothing.",
        needs=("baselines",),
        decide=baseline_drastic,
    ),
)
