"""The statements of the thesis, read from ``claims.yaml``, and their verdicts.

Shares of trials are decided by their exact interval, means by the interval of their difference, as
``rules`` describes. Each definition is true or false whatever the number of trials.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from trl_explore.thesis.algebra import RULE_NAMES, decision
from trl_explore.thesis.rules import FAILS, HOLDS, NOT_MEASURED, OPEN, Decision, Finding
from trl_explore.thesis.study import NotMeasuredError, Study


@dataclass(frozen=True)
class Claim:
    """A statement of the thesis with the function that decides it.

    Attributes:
        id: unique, ``theme.statement``.
        place: where the thesis says it.
        statement: what the thesis says.
        definition: precise meaning of the statement, and the test.
        decide: study -> finding; may raise :class:`NotMeasuredError`.
        performance: whether it is about performance, so that it can be asked of what was learned.
        corrected: whether it is decided again with each action corrected.
    """

    id: str
    place: str
    statement: str
    definition: str
    decide: Decision
    performance: bool = True
    corrected: bool = False


@dataclass(frozen=True)
class Checked:
    """A claim with its finding, and its finding for what was learned.

    ``learned`` is the verdict of the same function on the same trials, judged by the policy without
    the strategy; None if the claim is not about performance.
    """

    claim: Claim
    finding: Finding
    learned: Finding | None = None

    @property
    def twin(self) -> str:
        """Both verdicts in words, for example "holds as measured; open for what was learned"."""
        if self.learned is None or NOT_MEASURED in (self.finding.verdict, self.learned.verdict):
            return ""
        words = {HOLDS: "holds", FAILS: "does not hold", OPEN: "is open"}
        first, second = words[self.finding.verdict], words[self.learned.verdict]
        if first == second:
            return f"{first} as measured, and for what was learned"
        return f"{first} as measured; {second} for what was learned"


@dataclass(frozen=True)
class Reexamined:
    """A statement of the thesis, decided without and with correction on the same trials."""

    claim: Claim
    plain: Finding
    corrected: Finding

    @property
    def outcome(self) -> str:
        """Effect of the correction on the verdict."""
        for undecided in (NOT_MEASURED, OPEN):
            if undecided in (self.plain.verdict, self.corrected.verdict):
                return undecided
        if self.plain.verdict == HOLDS:
            return "survives" if self.corrected.verdict == HOLDS else "falls"
        return "becomes true" if self.corrected.verdict == HOLDS else "false either way"


def _claims(entries: Sequence[Mapping[str, Any]]) -> tuple[Claim, ...]:
    return tuple(
        Claim(
            decide=decision({key: v for key, v in entry.items() if key in RULE_NAMES}),
            **{key: v for key, v in entry.items() if key not in RULE_NAMES},
        )
        for entry in entries
    )


_FILE = yaml.safe_load(Path(__file__).with_name("claims.yaml").read_text(encoding="utf-8"))
CLAIMS, CAUSES = _claims(_FILE["claims"]), _claims(_FILE["causes"])
"""The statements of the thesis, and those about the cause, which it does not make."""


def check_claims(study: Study, claims: Sequence[Claim] = CLAIMS) -> list[Checked]:
    """Decide every claim on the data of a study, as measured and for what was learned.

    Missing data give ``not measured`` with the reason.
    """
    measured, learned = study.judged("passed"), study.judged("learned")
    return [
        Checked(c, _decide(c, measured), _decide(c, learned) if c.performance else None)
        for c in claims
    ]


def reexamine(study: Study) -> list[Reexamined]:
    """Decide the claims that can be tested under a correction twice, by the same test.

    Under argmax, ε-greedy or a temperature other than 1, actions are drawn from μ but the gradient
    is computed as if they came from π. The experiments ``corrections`` and
    ``corrections_temperature`` repeat the comparison with the ratio π/μ, on the same seeds.
    """
    claims = [claim for claim in CLAIMS if claim.corrected]
    without, ratio = (
        check_claims(study.under(name), claims) for name in ("NoCorrection", "PerStep")
    )
    return [Reexamined(a.claim, a.finding, b.finding) for a, b in zip(without, ratio, strict=True)]


def _decide(claim: Claim, study: Study) -> Finding:
    try:
        return claim.decide(study)
    except NotMeasuredError as missing:
        return Finding(NOT_MEASURED, str(missing))
