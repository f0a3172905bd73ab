"""The tables of verdicts: the thesis's statements, without and with correction of the bias."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

from trl_explore.report.evidence import Evidence
from trl_explore.report.results_tables import crossed_table
from trl_explore.report.table_formats import Column, Record, Table
from trl_explore.statistics.power import trials_text
from trl_explore.thesis import Checked, Reexamined

VERDICTS: Mapping[str, tuple[str, str]] = {
    "holds": ("hold", "holds"),
    "does not hold": ("do not hold", "does-not-hold"),
    "survives": ("survive", "holds"),
    "becomes true": ("become true", "holds"),
    "falls": ("fall", "does-not-hold"),
    "false either way": ("false either way", "does-not-hold"),
    "open": ("open", "open"),
    "not measured": ("not measured", "not-measured"),
}
"""Verdict, or outcome of the re-examination -> its plural and its CSS class."""


def tally(verdicts: Iterable[str]) -> list[tuple[str, str]]:
    """CSS class and text (``3 hold``) of every verdict that occurs.

    >>> tally(["open", "holds", "holds"])
    [('holds', '2 hold'), ('open', '1 open')]
    """
    counts = Counter(verdicts)
    return [
        (css, f"{counts[word]} {plural if counts[word] > 1 else word}")
        for word, (plural, css) in VERDICTS.items()
        if counts[word]
    ]


def claims_table(
    checked: Sequence[Checked],
    *,
    id: str = "claims",
    title: str = "The thesis's statements",
    said: str = "the thesis says",
) -> Table:
    """One row per statement: verdict, evidence, and how many trials would settle it.

    ``said`` is the title of the statement column.
    """
    records = [
        {
            "id": c.claim.id,
            "verdict": c.finding.verdict,
            "statement": c.claim.statement,
            "place": c.claim.place,
            "definition": c.claim.definition,
            "evidence": c.finding.evidence,
            "trials_needed": c.finding.trials_needed,
            "twin": c.twin,
            "learned": c.learned.verdict if c.learned else None,
            "learned_evidence": c.learned.evidence if c.learned else None,
        }
        for c in checked
    ]
    columns = [
        _verdict_column("verdict", "verdict"),
        Column("statement", said, lambda r: f"{r['statement']}\n({r['place']})", wide=True),
        Column("definition", "taken to mean", lambda r: r["definition"], wide=True),
        Column("evidence", "evidence", lambda r: r["evidence"], wide=True),
        Column("trials_needed", "trials to settle it",
               lambda r: trials_text(r["trials_needed"]), True),
    ]  # fmt: skip
    if any(r["twin"] for r in records):
        columns.insert(1, Column("twin", "and what was learned", _twin, wide=True))
    return Table(id, title, columns, records, main=True, kind="claims")


def _twin(r: Record) -> str:
    return f"{r['twin']}\n{r['learned_evidence']}" if r["twin"] else "–"


def why_tables(evidence: Evidence) -> list[Table]:
    """The tables on what survives a correction; empty if no corrections were run."""
    if not evidence.reexamined:
        return []
    return [
        conclusions_table(evidence.reexamined),
        claims_table(
            evidence.causes, id="why-causes", title="What the bias explains", said="statement"
        ),
        *(crossed_table(part) for part in evidence.groups if part.why),
    ]


def conclusions_table(reexamined: Sequence[Reexamined]) -> Table:
    """One row per statement: the outcome, and both verdicts with their evidence."""
    records = [
        {
            "id": r.claim.id,
            "outcome": r.outcome,
            "statement": r.claim.statement,
            "definition": r.claim.definition,
            "uncorrected": r.plain.verdict,
            "uncorrected_evidence": r.plain.evidence,
            "corrected": r.corrected.verdict,
            "corrected_evidence": r.corrected.evidence,
            "trials_needed": r.corrected.trials_needed,
        }
        for r in reexamined
    ]

    def both(which: str) -> Callable[[Record], str]:
        return lambda r: f"{r[which].upper()}: {r[f'{which}_evidence']}"

    columns = [
        _verdict_column("outcome", "when corrected"),
        Column("statement", "the thesis says", lambda r: r["statement"], wide=True),
        Column("uncorrected", "uncorrected", both("uncorrected"), wide=True),
        Column("corrected", "with the per-step ratio", both("corrected"), wide=True),
    ]
    title = "The thesis’s conclusions, with each action corrected"
    return Table("why-conclusions", title, columns, records, main=True, kind="claims")


def distance(evidence: Evidence) -> str:
    """A text on the smallest distance from μ to π at which most uncorrected trials failed."""
    found = []
    for part in evidence.groups:
        layout, distances = part.group.crossed, part.traces.diagnostics.get("kl", {})
        if not part.why or layout is None:
            continue
        for (row, option), name in layout.cells.items():
            summary = part.summary(name)
            if option == 0 and name in distances and summary.pass_rate.value < 0.5:
                corrected = [
                    f"{part.summary(layout.cells[row, o]).converged} with {label}"
                    for o, label in enumerate(layout.options)
                    if o and (row, o) in layout.cells
                ]
                found.append((distances[name].level, layout.rows[row], summary, corrected))
    text = (
        "The distance was recorded in every iteration. Even a small distance can matter: a bias has"
        " the same direction in every update and accumulates, while noise averages out."
    )
    if not found:
        return text
    size, row, summary, corrected = min(found, key=lambda f: f[0])
    return (
        f"{text} Under {row}, KL(μ‖π) was {size:.2g} nats on average, and {summary.converged}"
        f" of {summary.n} uncorrected trials passed ({', '.join(corrected)})."
    )


def _verdict_column(key: str, title: str) -> Column:
    return Column(key, title, lambda r: r[key], css=lambda r: f"verdict {VERDICTS[r[key]][1]}")
