"""§2.3.1: which ε passes."""

from __future__ import annotations

import numpy as np

from trl_explore.thesis import rules
from trl_explore.thesis.model import Claim, Finding
from trl_explore.thesis.study import NotMeasuredError, Study

BEST = 0.3


def only_one_epsilon_passes(study: Study, rng: np.random.Generator) -> Finding:
    """p(ε = 0.3) > 80 % and p(ε) < 80 % for every other ε of the grid."""
    grid = study.grid("epsilon_grid", "epsilon")
    if BEST not in grid or len(grid) < 2:
        raise NotMeasuredError(f"the ε grid needs {BEST} and at least one other value")
    parts = []
    for epsilon, outcomes in grid.items():
        rule = rules.share_above if epsilon == BEST else rules.share_below
        what = f"trials pass at ε = {epsilon:g}"
        count = int(outcomes.converged.sum())
        parts.append(rule(count, len(outcomes), rules.ALMOST_ALWAYS, what))
    return rules.all_of(parts, study.level)


CLAIMS = (
    Claim(
        id="epsilon_grid.only_0.3_passes",
        statement="Only ε = 0.3 passes almost consistently.",
        place="§2.3.1, fig. 2.1",
        definition="Almost consistently: in more than 80 % of trials. The Wilson interval of"
        " ε = 0.3 lies above 80 %, that of every other value of the grid below.",
        needs=("epsilon_grid",),
        decide=only_one_epsilon_passes,
    ),
)
