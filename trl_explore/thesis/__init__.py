"""The statements of the thesis as data, each with the test that decides it.

One module per part of the thesis; each ends with its ``CLAIMS``. A new claim is one more entry
(and, where no function fits, one more function) in one of them.

Each verdict stands at the level of its study by itself; with some thirty claims at 95 %, one
wrong verdict among them would be no surprise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trl_explore.statistics.bootstrap import streams
from trl_explore.thesis import (
    conclusion,
    decay_grid,
    epsilon_grid,
    iterations,
    outlook,
    score,
    time,
)
from trl_explore.thesis.model import (
    FAILS,
    HOLDS,
    NOT_MEASURED,
    OPEN,
    VERDICTS,
    Checked,
    Claim,
    Finding,
    Verdict,
)
from trl_explore.thesis.study import NotMeasuredError, Study

CLAIMS: tuple[Claim, ...] = (
    *epsilon_grid.CLAIMS,
    *decay_grid.CLAIMS,
    *score.CLAIMS,
    *iterations.CLAIMS,
    *time.CLAIMS,
    *conclusion.CLAIMS,
    *outlook.CLAIMS,
)


def check_claims(
    study: Study, rng: np.random.Generator, claims: Sequence[Claim] = CLAIMS
) -> list[Checked]:
    """Decide every claim on the data of a study.

    Each claim has a random stream of its own, so that its verdict does not depend on which
    other claims there are. Missing data give ``not measured`` with the reason.
    """
    rngs = streams(rng, [claim.id for claim in claims])
    return [Checked(claim, _decide(claim, study, rngs[claim.id])) for claim in claims]


def _decide(claim: Claim, study: Study, rng: np.random.Generator) -> Finding:
    try:
        return claim.decide(study, rng)
    except NotMeasuredError as missing:
        return Finding(NOT_MEASURED, str(missing))


__all__ = [
    "CLAIMS",
    "FAILS",
    "HOLDS",
    "NOT_MEASURED",
    "OPEN",
    "VERDICTS",
    "Checked",
    "Claim",
    "Finding",
    "NotMeasuredError",
    "Study",
    "Verdict",
    "check_claims",
]
