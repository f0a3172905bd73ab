"""Fig. 3.2: iterations to convergence by strategy."""

from __future__ import annotations

import numpy as np

from trl_explore.thesis import rules
from trl_explore.thesis.model import OPEN, Claim, Finding
from trl_explore.thesis.study import STRATEGIES, Study

LEAST_OF_ARGMAX = 450


def argmax_needs_450(study: Study, rng: np.random.Generator) -> Finding:
    """No trial of argmax converges before iteration 450."""
    o = study.strategy("argmax")
    passed = o.iterations[o.converged]
    if len(passed) == 0:
        return Finding(OPEN, f"0 of {len(o)} argmax trials pass")
    early = int((passed < LEAST_OF_ARGMAX).sum())
    what = f"passing argmax trials take fewer than {LEAST_OF_ARGMAX} iterations"
    finding = rules.never(early, len(passed), what)(study.level)
    needed = finding.trials_needed
    if needed is not None:
        # Only trials that pass count: a trial is worth the present pass rate of one.
        needed = -(-needed * len(o) // len(passed))
    text = f"{finding.evidence}; the fastest takes {passed.min()}"
    return Finding(finding.verdict, text, needed)


def decaying_beats_constant(study: Study, rng: np.random.Generator) -> Finding:
    """mean(decaying) < mean(constant) over the trials that converge under both."""
    a, b = (
        study.sample(study.strategy(name), "iterations")
        for name in ("decaying_epsilon_greedy", "epsilon_greedy")
    )
    a, b = a.only(a.converged), b.only(b.converged)
    return rules.mean_less(a, b, rng, resamples=study.resamples)(study.level)


def softmax_needs_fewest(study: Study, rng: np.random.Generator) -> Finding:
    """mean(softmax) < mean(other) for each of the other strategies, restricted to the cap."""
    samples = {n: study.sample(study.strategy(n), "iterations") for n in study.strategies}
    best = samples.pop("softmax")
    return rules.all_of(
        [rules.mean_less(best, s, rng, resamples=study.resamples) for s in samples.values()],
        study.level,
    )


def epsilon_greedy_needs_most(study: Study, rng: np.random.Generator) -> Finding:
    """mean(ε-greedy) > mean(other) for decaying ε-greedy and softmax, restricted to the cap."""
    worst = study.sample(study.strategy("epsilon_greedy"), "iterations")
    others = [
        study.sample(study.strategy(n), "iterations")
        for n in ("decaying_epsilon_greedy", "softmax")
    ]
    return rules.all_of(
        [rules.mean_less(s, worst, rng, resamples=study.resamples) for s in others], study.level
    )


CLAIMS = (
    Claim(
        id="iterations.argmax_needs_450",
        statement="The trials of argmax that pass take at least 450 iterations.",
        place="Results, fig. 3.2",
        definition="One trial that converges in fewer refutes it; it holds where there is none and"
        " the Wilson interval over the passing trials ends below 5 %.",
        needs=("thesis/argmax",),
        decide=argmax_needs_450,
    ),
    Claim(
        id="iterations.decaying_fewer_than_epsilon_greedy",
        statement="Apart from outliers, decaying ε-greedy converges in fewer iterations than"
        " ε-greedy.",
        place="Results, fig. 3.2; Discussion",
        definition="Outliers are trials at the cap. Over the trials (same seed and index) that"
        " converge under both strategies, the mean is smaller (paired bootstrap interval and"
        " sign-flip test).",
        needs=("thesis/decaying_epsilon_greedy", "thesis/epsilon_greedy"),
        decide=decaying_beats_constant,
    ),
    Claim(
        id="iterations.softmax_fewest",
        statement="Softmax needs the fewest iterations to converge.",
        place="Discussion",
        definition="Its mean number of iterations, restricted to the cap, is smaller than that of"
        " each other strategy (paired bootstrap interval and sign-flip test).",
        needs=tuple(f"thesis/{name}" for name in STRATEGIES),
        decide=softmax_needs_fewest,
    ),
    Claim(
        id="iterations.epsilon_greedy_most",
        statement="ε-greedy takes the most iterations of the strategies that pass.",
        place="Discussion",
        definition="The strategies that pass: ε-greedy, decaying ε-greedy and softmax. Its mean"
        " number of iterations, restricted to the cap, is larger than that of the other two"
        " (paired bootstrap interval and sign-flip test).",
        needs=("thesis/epsilon_greedy", "thesis/decaying_epsilon_greedy", "thesis/softmax"),
        decide=epsilon_greedy_needs_most,
    ),
)
