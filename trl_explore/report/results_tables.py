"""The tables of numbers: configurations, pairs of configurations, jobs."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from shlex import quote
from typing import Any

import numpy as np

from trl_explore.report.evidence import Answered, Evidence, GroupEvidence
from trl_explore.report.figures.axes import number
from trl_explore.report.questions import shown
from trl_explore.report.table_formats import (
    Column,
    Record,
    Table,
    estimate_cell,
    p_cell,
    plain_columns,
    rate_cell,
    rounded,
)
from trl_explore.statistics.comparisons import Comparison
from trl_explore.statistics.estimates import flat
from trl_explore.statistics.power import fewest_pairs, trials_text, trials_to_settle
from trl_explore.statistics.summary import Summary


def group_tables(part: GroupEvidence) -> list[Table]:
    """The tables of a group: configurations, pairs, and the pairs of each further question."""
    tables = [summary_table(part), comparison_table(part)]
    tables += [
        comparison_table(part, answered=answered)
        for answered in part.answered
        if answered.comparisons != part.comparisons
    ]
    return tables + ([comparison_table(part.learned, learned=True)] if part.learned else [])


def summary_table(evidence: GroupEvidence) -> Table:
    """One row per configuration."""
    group, learned = evidence.group, evidence.learned
    records = []
    for c, summary in zip(group.configurations, evidence.summaries, strict=True):
        seconds = group.timed(c)[1]
        record = {"configuration": group.labels[c.name], **summary.row()}
        if learned is not None:
            record |= {f"learned_{k}": v for k, v in learned.summary(c.name).row().items()}
        record["seconds_mean"] = float(seconds.mean()) if len(seconds) else None
        records.append(record | {"timed": len(seconds)})

    def column(key: str, title: str, *text: Any) -> Column:
        return Column(key, title, estimate_cell(key, *text), True)

    columns = [
        *plain_columns("configuration"),
        Column("pass_rate", group.did, rate_cell(), True),
        column("median", "median iterations", _count, "not reached"),
        column("restricted_mean", "mean iterations", _count),
        column("expected_running_time", "iterations per success", _count),
        column("score_mean", "mean score", _score),
        column("score_iqm", "interquartile mean", _score),
        column("frames_mean", "mean frames", _count),
    ]
    if learned is not None:
        columns.insert(2, Column("learned_pass_rate", "learned", rate_cell("learned_"), True))
        mean = "learned_restricted_mean"
        columns.insert(5, column(mean, "mean iterations to learning", _count))
        columns.insert(8, column("learned_score_mean", "learned score", _score))
    if any(r["timed"] for r in records):
        columns.append(Column("seconds_mean", "seconds", _seconds, True))
    title = f"{group.title}: configurations"
    return Table(f"{group.id}-configurations", title, columns, records, main=True, kind="cards")


def pair_records(
    comparisons: Sequence[Comparison], labels: Mapping[str, str]
) -> list[dict[str, Any]]:
    """One record per pair, with the number of trials that would detect the difference."""
    records = []
    for c in comparisons:
        needed = trials_to_settle(c.difference, 0.0, min(c.n_a, c.n_b))
        named = {"a": labels[c.a], "b": labels[c.b], "winner": labels.get(c.winner or "")}
        fewest = fewest_pairs(c.difference.level)
        records.append(c.row() | named | {"trials_needed": needed and max(needed, fewest)})
    return records


def pair_columns(
    quantity: str = "",
    text: Callable[[float], str] = rounded,
    *,
    better: str = "better",
    by: str = "",
    short: Callable[[str], str] = str,
) -> list[Column]:
    """The columns of :func:`pair_records`; ``quantity`` and ``by`` follow their titles."""
    return [
        Column("a", f"first{by}", lambda r: short(r["a"])),
        Column("b", f"second{by}", lambda r: short(r["b"])),
        Column("winner", better, lambda r: short(r["winner"]) if r["winner"]
               else r["same"] or "not significant"),
        Column("difference", f"first − second{quantity}", estimate_cell("difference", text), True),
        Column("p_holm", "p (Holm)", p_cell("p_holm"), True),
        Column("better", f"first is {better} in", estimate_cell("better", _percent), True),
        Column("n_a", "compared", _compared, True),
        Column("trials_needed", "trials for 80 % power",
               lambda r: trials_text(r["trials_needed"], "–"), True),
    ]  # fmt: skip


def comparison_table(
    evidence: GroupEvidence, *, learned: bool = False, answered: Answered | None = None
) -> Table:
    """The pairs of a group, in iterations and scores.

    Args:
        evidence: the results of a group by one measure.
        learned: whether that is what was learned.
        answered: the question whose pairs are shown; None: the planned pairs of the group.
    """
    group, labels = evidence.group, evidence.group.labels
    short = {label: group.short(name) for name, label in labels.items()}
    scores = {(s.a, s.b): s for s in evidence.scores}
    compared = answered.comparisons if answered else evidence.comparisons
    records = pair_records(compared, labels)
    for c, record in zip(compared, records, strict=True):
        record["experiment"] = group.experiment
        if (score := scores.get((c.a, c.b))) is not None:
            record |= flat({"score_difference": score.difference, "score_p_holm": score.p_holm})
            record["higher_score"] = labels.get(score.winner or "")
    by = f" {group.parameter}" if group.parameter else ""
    columns = pair_columns(", iterations", _count, better="faster", by=by, short=short.__getitem__)
    columns[5:5] = [
        Column("score_difference", "first − second, score", _difference, True),
        Column("p_logrank", "p (log-rank)", p_cell("p_logrank"), True),
    ]
    columns.insert(8, Column("variance_ratio", "variance kept by pairing", _ratio, True))
    planned = group.crossed is not None or group.plane is not None
    title, end = f"{group.title}: {'planned pairs' if planned else 'all pairs'}", "pairs"
    if learned:
        title, end = f"{title}, by what was learned", "pairs-learned"
    if answered:
        title = f"{group.title}: pairs for the effect of {answered.question.of}"
        keys = "-".join(factor.key.lower() for factor in answered.question.factors)
        end = f"pairs-{re.sub(r'[^a-z0-9]+', '-', keys)}"
    return Table(f"{group.id}-{end}", title, columns, records, main=True, kind="cards")


def crossed_table(part: GroupEvidence) -> Table:
    """One row per row of a crossed group, one column per option: pass rate, mean and median."""
    layout = part.group.crossed
    assert layout is not None
    records = []
    for k, row in enumerate(layout.rows):
        record: dict[str, Any] = {"row": row}
        for o, option in enumerate(layout.options):
            if name := layout.cells.get((k, o)):
                s = part.summary(name)
                numbers = flat({"pass_rate": s.pass_rate, "restricted_mean": s.restricted_mean})
                numbers |= {"median": s.median.value, "summary": _cell(s)}
                record |= {f"{option}: {key}": value for key, value in numbers.items()}
        records.append(record)

    def cell(option: str) -> Callable[[Record], str]:
        return lambda r: str(r.get(f"{option}: summary", "–"))

    columns = [Column("row", part.group.title, lambda r: r["row"])]
    columns += [Column(f"{o}: restricted_mean", o, cell(o), True) for o in layout.options]
    title = f"{part.group.title}: passed, mean and median iterations"
    return Table(f"{part.group.id}-crossed", title, columns, records, main=True)


def _cell(s: Summary) -> str:
    middle = number(s.median.value) if s.median.value < math.inf else "not reached"
    low, high = 100 * s.pass_rate.low, 100 * s.pass_rate.high
    mean = s.restricted_mean
    return (
        f"{s.converged} of {s.n} [{low:.0f}, {high:.0f}] %\nmean {mean.value:,.0f}"
        f" [{mean.low:,.0f}, {mean.high:,.0f}]\nmedian {middle}"
    )


def jobs_table(evidence: Evidence) -> Table:
    """One row per job, with the command that repeats it."""
    records = []
    for part in evidence.groups:
        for c in part.group.configurations:
            for job in part.group.jobs[c.name]:
                o, source = job.outcomes, job.outcomes.provenance
                first, last = int(o.trial.min()), int(o.trial.max())
                words = map(quote, shown(job.command))
                records.append({
                    "experiment": o.experiment, "job": o.name,
                    "configuration": part.group.labels[c.name], "seed": source.get("seed"),
                    "trials": len(o), "first_trial": first, "last_trial": last,
                    "cap": o.cap, "threshold": o.threshold, "window": o.window,
                    "environment": part.group.environment, "collector": source.get("collector"),
                    "batch_seconds": _number(source.get("seconds")),
                    "command": " ".join(("trl-explore train", *words)),
                })  # fmt: skip
    unique = list({(r["experiment"], r["job"], str(r)): r for r in records}.values())
    columns = [
        *plain_columns("experiment", "configuration"),
        Column("seed", "seed", lambda r: str(r["seed"]), True),
        Column("trials", "trials", lambda r: f"{r['trials']:,}", True),
        Column("first_trial", "indices", lambda r: f"{r['first_trial']}–{r['last_trial']}", True),
        Column("cap", "cap", lambda r: f"{r['cap']:,}", True),
        *plain_columns("environment", "collector"),
        Column("command", "command", lambda r: r["command"], wide=True),
    ]
    return Table("jobs", "Jobs", columns, unique)


def gaps_table(evidence: Evidence) -> Table:
    """What is missing from the report, with the reason."""
    records = [{"what": gap.what, "why": gap.why} for gap in evidence.gaps]
    columns = [
        Column("what", "missing", lambda r: r["what"]),
        Column("why", "reason", lambda r: r["why"], wide=True),
    ]
    return Table("missing", "Missing from this report", columns, records)


def _seconds(r: Record) -> str:
    return f"{r['seconds_mean']:.3g}\n{r['timed']} timed" if r["timed"] else "–"


def _compared(r: Record) -> str:
    other = "pairs" if r["design"] == "paired" else f"and {r['n_b']:,}"
    return f"{r['n_a']:,} {other}" + (f"\n{r['dropped']:,} left out" if r["dropped"] else "")


def _count(x: float) -> str:
    return f"{x:,.0f}".replace("-", "−")


def _score(x: float) -> str:
    return f"{x:,.1f}".replace("-", "−") if abs(x) >= 9.995 else rounded(x)


def _percent(x: float) -> str:
    return f"{100 * x:.0f} %"


def _ratio(r: Record) -> str:
    x = r["variance_ratio"]
    return "–" if np.isnan(x) else f"{x:.2f}"


def _difference(r: Record) -> str:
    if "score_difference" not in r:
        return "–"
    return f"{estimate_cell('score_difference', _score)(r)}\np {p_cell('score_p_holm')(r)}"


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) else None
