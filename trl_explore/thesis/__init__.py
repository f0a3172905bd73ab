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
