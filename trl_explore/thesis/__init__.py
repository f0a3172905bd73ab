"""The statements of the thesis, and the test that decides each one.

``study``       access to the data of the experiments
``rules``       verdicts from intervals and tests
``shares``      decisions on shares of trials; ``means`` on means and quantiles
``claims``      the table of statements; each is also decided for what was learned
``reexamined``  which statements remain true when the gradient is corrected

To add a claim, add an entry to ``claims`` (and a decision function if none fits). Each verdict has
the confidence level of the study, without correction across claims: among about thirty claims at
95 %, one wrong verdict is to be expected.
"""

from __future__ import annotations

from trl_explore.thesis.claims import CLAIMS, Checked, Claim, check_claims
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
