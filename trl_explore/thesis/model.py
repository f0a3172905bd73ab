"""What a claim is, and what deciding it yields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from trl_explore.thesis.study import Study

Verdict = Literal["holds", "does not hold", "open", "not measured"]
HOLDS: Verdict = "holds"
FAILS: Verdict = "does not hold"
OPEN: Verdict = "open"
NOT_MEASURED: Verdict = "not measured"
VERDICTS: tuple[Verdict, ...] = (HOLDS, FAILS, OPEN, NOT_MEASURED)


@dataclass(frozen=True)
class Finding:
    """The verdict on a claim.

    Attributes:
        verdict: ``holds``, ``does not hold``, ``open`` (these data decide neither), or
            ``not measured``.
        evidence: the numbers, intervals and tests that the verdict follows from.
        trials_needed: of an open claim: trials per configuration that would settle it with
            80 % power if the present estimates were the truth; None where not computable.
            Of claims about the trials that converge, it counts those only.

    """

    verdict: Verdict
    evidence: str
    trials_needed: int | None = None


@dataclass(frozen=True)
class Claim:
    """A statement of the thesis with the procedure that decides it.

    Attributes:
        id: unique, ``theme.statement``.
        statement: what the thesis says.
        place: where it says so.
        definition: what the statement is taken to mean, vague words included, and the test.
        needs: the data it needs, as ``experiment``, ``experiment/strategy`` or ``seconds``.
        decide: study and generator to finding; may raise :class:`NotMeasuredError`.

    """

    id: str
    statement: str
    place: str
    definition: str
    needs: tuple[str, ...]
    decide: Callable[[Study, np.random.Generator], Finding]


@dataclass(frozen=True)
class Checked:
    """A claim together with its finding."""

    claim: Claim
    finding: Finding
