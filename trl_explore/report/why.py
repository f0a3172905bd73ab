"""The section *Why*: the comparison again with the bias removed, and how far μ was from π."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import Any

from trl_explore.report.claims_table import claims_table
from trl_explore.report.evidence import WHY, Evidence, GroupEvidence
from trl_explore.report.figures.axes import number
from trl_explore.report.labels import readable
from trl_explore.report.layout_captions import level
from trl_explore.report.tables import Column, Record, Table
from trl_explore.statistics.summary import Summary
from trl_explore.thesis.why import Reexamined

EFFECTS = "effects"
FIGURES = (EFFECTS, "kl", "effective_sample_size", "ratio_mean")
"""Kinds of figures that this section shows: what corrections do, and how far μ was from π."""
CSS = {
    "survives": "holds",
    "becomes true": "holds",
    "falls": "does-not-hold",
    "false either way": "does-not-hold",
    "open": "open",
    "not measured": "not-measured",
}

PLURAL = {"survives": "survive", "becomes true": "become true", "falls": "fall"}

TEXT = """
<p>REINFORCE follows the gradient of what the policy π would earn, and for that the actions must
come from π. Only softmax at temperature 1 does that: there the behaviour policy μ, from which the
actions are drawn, is π itself. Under argmax, ε-greedy or another temperature the thesis’s program
(and this one, unless told otherwise) takes the data of μ as if they were data of π. The estimate
is then <b>biased</b>: it is the gradient of neither policy’s return. So two things differ between
strategies, what they explore and how wrong their gradient is. Here the second is corrected, on
the same seeds and trials, in ways that differ in what they leave:</p>
<ul>
<li><b>per-step ratio</b>: the term of each action is weighted with π/μ of that action. This
corrects the <i>action</i>, and not the <i>states</i> nor the rewards that follow: those are still
the ones that μ meets. Biased, but no longer in the direction of each step; the weights vary
little.</li>
<li><b>per-decision</b> and <b>trajectory weights</b>: the product of the ratios up to the reward,
or of the whole episode. Unbiased (where μ takes every action that π takes), but a product of
hundreds of ratios varies so much that few episodes decide everything.</li>
<li><b>gradient of μ</b>: log μ in the place of log π, where μ depends smoothly on the policy’s
weights (softmax at any temperature, but no ε-greedy). Then the agent <i>is</i> μ, and its own
gradient is unbiased without any weights.</li>
</ul>
<p><b>No weight repairs argmax.</b> A ratio can weigh what was done; what is never done has
probability 0 under μ, and no data about it exist. Its verdict as a strategy stands, whatever the
loss.</p>
"""


def applies(part: GroupEvidence) -> bool:
    """Whether a group belongs to this section."""
    return part.group.experiment in WHY and part.group.crossed is not None


def why_tables(evidence: Evidence) -> list[Table]:
    """The tables of the section; none without corrections."""
    if not evidence.reexamined:
        return []
    return [
        conclusions_table(evidence.reexamined),
        claims_table(
            evidence.causes, id="why-causes", title="What the bias explains", said="statement"
        ),
        *(crossed_table(part) for part in evidence.groups if applies(part)),
    ]


def why_section(evidence: Evidence, effects: str, distances: str, tables: Sequence[str]) -> str:
    """The section as HTML.

    Args:
        evidence: of the report.
        effects: figures of what the corrections do, as HTML.
        distances: figures of how far μ was from π, as HTML; empty where that was not recorded.
        tables: of :func:`why_tables`, as HTML.

    """
    counts: dict[str, int] = {}
    for r in evidence.reexamined:
        counts[r.outcome] = counts.get(r.outcome, 0) + 1
    tally = "".join(
        f'<li class="verdict {CSS[o]}">{counts[o]} {PLURAL.get(o, o) if counts[o] > 1 else o}</li>'
        for o in CSS
        if o in counts
    )
    far = (
        f'<h3>How far μ was from π</h3><p class="prose">{escape(_distance(evidence))}</p>'
        f"{_figures(distances)}"
        if distances
        else ""
    )
    return (
        '<section id="why"><h2>Why: the bias, and the exploration</h2>'
        f'<div class="prose">{TEXT}</div><h3>Which conclusions survive</h3>'
        '<p class="prose">Each statement is decided twice by the same test, with the same trials:'
        " once as the thesis did it, once with the per-step ratio. It <i>survives</i> where it"
        f' holds both times.</p><ul class="tally">{tally}</ul>{"".join(tables)}'
        f"{_figures(effects)}{far}</section>"
    )


def _figures(drawn: str) -> str:
    return f'<div class="figures">{drawn}</div>' if drawn else ""


def _distance(evidence: Evidence) -> str:
    """In words: the smallest distance at which most uncorrected trials failed."""
    found = []
    for part in filter(applies, evidence.groups):
        layout, distances = part.group.crossed, part.traces.diagnostics.get("kl", {})
        assert layout is not None
        for (row, option), name in layout.cells.items():
            summary = part.summary(name)
            if option == 0 and name in distances and summary.pass_rate.value < 0.5:
                found.append((level(distances[name]), layout.rows[row], summary, part, row))
    text = (
        "The distance was recorded in every iteration. What counts is not its size alone: a bias"
        " pushes every update the same way and adds up, while noise averages out."
    )
    if not found:
        return text
    distance, row, summary, part, place = min(found, key=lambda f: f[0])
    layout = part.group.crossed
    assert layout is not None
    corrected = [
        f"{part.summary(layout.cells[place, o]).converged} with {option}"
        for o, option in enumerate(layout.options)
        if o and (place, o) in layout.cells
    ]
    return (
        f"{text} Under {row}, KL(μ‖π) was {distance:.2g} nats on average, and {summary.converged}"
        f" of {summary.n} uncorrected trials passed ({', '.join(corrected)})."
    )


def conclusions_table(reexamined: Sequence[Reexamined]) -> Table:
    """One row per statement: what becomes of it, and both verdicts with their evidence."""
    records = [
        {
            "id": r.claim.id,
            "outcome": r.outcome,
            "statement": r.claim.statement,
            "definition": readable(r.claim.definition),
            "uncorrected": r.plain.verdict,
            "uncorrected_evidence": readable(r.plain.evidence),
            "corrected": r.corrected.verdict,
            "corrected_evidence": readable(r.corrected.evidence),
            "trials_needed": r.corrected.trials_needed,
        }
        for r in reexamined
    ]
    columns = [
        Column("outcome", "when corrected", lambda r: r["outcome"],
               css=lambda r: "verdict " + CSS[r["outcome"]]),
        Column("statement", "the thesis says", lambda r: r["statement"], wide=True),
        Column("uncorrected", "uncorrected", _verdict("uncorrected"), wide=True),
        Column("corrected", "with the per-step ratio", _verdict("corrected"), wide=True),
    ]  # fmt: skip
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
                }
                record |= {f"{option}: {key}": value for key, value in numbers.items()}
                record[f"{option}: summary"] = _cell(summary)
        records.append(record)
    columns = [Column("row", part.group.title, lambda r: r["row"])]
    columns += [
        Column(f"{option}: restricted_mean", option, _get(f"{option}: summary"), True)
        for option in layout.options
    ]
    title = f"{part.group.title}: passed, mean and median iterations"
    return Table(f"{part.group.id}-crossed", title, columns, records, main=True)


def _cell(s: Summary) -> str:
    middle = f"{number(s.median.value)}" if s.median.value < float("inf") else "not reached"
    low, high = 100 * s.pass_rate.low, 100 * s.pass_rate.high
    return (
        f"{s.converged} of {s.n} ({low:.0f} to {high:.0f} %)\nmean {s.restricted_mean:,.0f} ±"
        f" {s.restricted_mean_se:,.0f}\nmedian {middle}"
    )


def _get(key: str) -> Callable[[Record], str]:
    return lambda r: str(r.get(key, "–"))


def _verdict(which: str) -> Callable[[Record], str]:
    return lambda r: f"{r[which].upper()}: {r[f'{which}_evidence']}"
