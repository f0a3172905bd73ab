"""The statements of the thesis, each with the test that decides it.

``study``   the data, as claims ask for them
``rules``   verdicts, and how intervals and tests reach them
``shares``  procedures on shares of trials; ``means``  on means and other statistics
``claims``  the table of statements
``why``     which of them remain when the gradient is corrected

A new claim is one more entry in ``claims`` (and, where no procedure fits, one more function). Each
verdict stands at the level of its study by itself; with some thirty claims at 95 %, one wrong
verdict among them would be no surprise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trl_explore.statistics.bootstrap import streams
from trl_explore.thesis.claims import CLAIMS, Checked, Claim
from trl_explore.thesis.rules import (
    FAILS,
    HOLDS,
    NOT_MEASURED,
    OPEN,
    VERDICTS,
    Finding,
    Verdict,
)
from trl_explore.thesis.study import NotMeasuredError, Study

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


def check_claims(
    study: Study, rng: np.random.Generator, claims: Sequence[Claim] = CLAIMS
) -> list[Checked]:
    """Decide every claim on the data of a study.

    Each claim has a random stream of its own, so that its verdict does not depend on which
    other claims there are. Missing data give ``not measured`` with the reason.
    """
    rngs = streams(rng, [claim.id for claim in claims])
    return [claim.check(study, rngs[claim.id]) for claim in claims]
