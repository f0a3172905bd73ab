"""The tables of verdicts: the thesis's statements, without and with correction of the bias."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from trl_explore.report.evidence import Evidence, GroupEvidence
from trl_explore.report.figures.axes import number
from trl_explore.report.tables import Column, Record, Table
from trl_explore.statistics.summary import Summary
from trl_explore.thesis import Checked
from trl_explore.thesis.why import Reexamined

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

    Args:
        checked: statements with their findings.
        id: id of the table.
        title: title of the table.
        said: title of the statement column.

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
        }
        for c in checked
    ]
    columns = [
        _verdict_column("verdict", "verdict"),
        Column("statement", said, lambda r: f"{r['statement']}\n({r['place']})", wide=True),
        Column("definition", "taken to mean", lambda r: r["definition"], wide=True),
        Column("evidence", "evidence", lambda r: r["evidence"], wide=True),
        Column("trials_needed", "trials to settle it",
               lambda r: "" if r["trials_needed"] is None else f"{r['trials_needed']:,}", True),
    ]  # fmt: skip
    return Table(id, title, columns, records, main=True, kind="claims")


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


def crossed_table(part: GroupEvidence) -> Table:
    """One row per row of a crossed group, one column per option: pass rate, mean and median."""
    layout = part.group.crossed
    assert layout is not None
    records: list[dict[str, Any]] = []
    for k, row in enumerate(layout.rows):
        record: dict[str, Any] = {"row": row}
        for o, option in enumerate(layout.options):
            name = layout.cells.get((k, o))
            if name is not None:
                summary = part.summary(name)
                numbers = {
                    "pass_rate": summary.pass_rate.value,
                    "pass_rate_low": summary.pass_rate.low,
                    "pass_rate_high": summary.pass_rate.high,
                    "restricted_mean": summary.restricted_mean,
                    "restricted_mean_se": summary.restricted_mean_se,
                    "median": summary.median.value,
                    "summary": _cell(summary),
                }
                record |= {f"{option}: {key}": value for key, value in numbers.items()}
        records.append(record)

    def cell(option: str) -> Callable[[Record], str]:
        return lambda r: str(r.get(f"{option}: summary", "–"))

    columns = [Column("row", part.group.title, lambda r: r["row"])]
    columns += [
        Column(f"{option}: restricted_mean", option, cell(option), True)
        for option in layout.options
    ]
    title = f"{part.group.title}: passed, mean and median iterations"
    return Table(f"{part.group.id}-crossed", title, columns, records, main=True)


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


def _cell(s: Summary) -> str:
    middle = number(s.median.value) if s.median.value < float("inf") else "not reached"
    low, high = 100 * s.pass_rate.low, 100 * s.pass_rate.high
    return (
        f"{s.converged} of {s.n} ({low:.0f} to {high:.0f} %)\nmean {s.restricted_mean:,.0f} ±"
        f" {s.restricted_mean_se:,.0f}\nmedian {middle}"
    )
