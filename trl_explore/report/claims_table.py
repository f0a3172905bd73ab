"""The table of the thesis's statements and their verdicts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from trl_explore.report.labels import readable
from trl_explore.report.tables import Column, Table
from trl_explore.thesis import VERDICTS, Checked

PLURAL = {"holds": "hold", "does not hold": "do not hold"}


def claims_table(
    checked: Sequence[Checked],
    *,
    id: str = "claims",
    title: str = "The thesis's statements",
    said: str = "the thesis says",
) -> Table:
    """One row per statement: verdict, evidence, and how many trials would settle it.

    Args:
        checked: statements with their findings.
        id: of the table.
        title: of the table.
        said: title of the column of statements.

    """
    records = [
        {
            "id": c.claim.id,
            "verdict": c.finding.verdict,
            "statement": c.claim.statement,
            "place": c.claim.place,
            "definition": readable(c.claim.definition),
            "evidence": readable(c.finding.evidence),
            "trials_needed": c.finding.trials_needed,
        }
        for c in checked
    ]
    columns = [
        Column(
            "verdict",
            "verdict",
            lambda r: r["verdict"],
            css=lambda r: "verdict " + r["verdict"].replace(" ", "-"),
        ),
        Column("statement", said, lambda r: f"{r['statement']}\n({r['place']})",
               wide=True),
        Column("definition", "taken to mean", lambda r: r["definition"], wide=True),
        Column("evidence", "evidence", lambda r: r["evidence"], wide=True),
        Column("trials_needed", "trials to settle it",
               lambda r: "" if r["trials_needed"] is None else f"{r['trials_needed']:,}", True),
    ]  # fmt: skip
    return Table(id, title, columns, records, main=True, kind="claims")


def tally(checked: Sequence[Checked]) -> dict[str, int]:
    """Verdict -> number of statements, in a fixed order, those that occur."""
    counts = Counter(c.finding.verdict for c in checked)
    return {verdict: counts[verdict] for verdict in VERDICTS if counts[verdict]}
