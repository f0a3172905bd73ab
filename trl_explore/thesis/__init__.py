"""The statements of the thesis, and the test that decides each one.

``study``        access to the data of the experiments
``rules``        verdicts from intervals and tests
``algebra``      the rules by name, as claims use them; ``particular`` those of single claims
``claims.yaml``  the statements; ``claims`` reads and decides them, also for what was learned, and
                 again where the gradient is corrected

To add a claim, add an entry to ``claims.yaml``. Each verdict has the confidence level of the study,
without correction across claims: among about thirty claims at 95 %, one wrong verdict is to be
expected.
"""

from __future__ import annotations

from trl_explore.thesis.claims import (
    CAUSES,
    CLAIMS,
    Checked,
    Claim,
    Reexamined,
    check_claims,
    reexamine,
)
from trl_explore.thesis.rules import FAILS, HOLDS, NOT_MEASURED, OPEN, VERDICTS, Finding, Verdict
from trl_explore.thesis.study import NotMeasuredError, Study

__all__ = [
    "CAUSES",
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
    "Reexamined",
    "Study",
    "Verdict",
    "check_claims",
    "reexamine",
]
