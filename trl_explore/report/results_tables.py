"""The tables of numbers: configurations, pairs of configurations, jobs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from trl_explore.report.evidence import Evidence, GroupEvidence
from trl_explore.report.figures.axes import number
from trl_explore.report.tables import Column, Record, Table, figure
from trl_explore.statistics.estimates import flat
from trl_explore.statistics.power import trials_text, trials_to_settle
from trl_explore.statistics.summary import Summary

UNKNOWN = (-math.inf, math.inf)


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
    columns = [
        Column("configuration", "configuration", lambda r: r["configuration"]),
        Column("pass_rate", "passed", _passed(""), True),
        Column("median", "median iterations", _interval("median", _count, "not reached"), True),
        Column("restricted_mean", "mean iterations", _interval("restricted_mean", _count), True),
        Column(
            "expected_running_time",
            "iterations per success",
            _interval("expected_running_time", _count, "∞"),
            True,
        ),
        Column("score_mean", "mean score", _interval("score_mean", _score), True),
        Column("score_iqm", "interquartile mean", _interval("score_iqm", _score), True),
        Column("frames_mean", "mean frames", _interval("frames_mean", _count), True),
    ]
    if learned is not None:
        columns[2:2] = [Column("learned_pass_rate", "learned", _passed("learned_"), True)]
        columns[5:5] = [
            Column("learned_restricted_mean", "mean iterations to learning",
                   _interval("learned_restricted_mean", _count), True),
        ]  # fmt: skip
        columns[8:8] = [
            Column("learned_score_mean", "learned score",
                   _interval("learned_score_mean", _score), True),
        ]  # fmt: skip
    if any(r["timed"] for r in records):
        columns.append(Column("seconds_mean", "seconds", _seconds, True))
    return Table(f"{group.id}-configurations", f"{group.title}: configurations", columns, records,
                 main=True)  # fmt: skip


def comparison_table(evidence: GroupEvidence, *, learned: bool = False) -> Table:
    """One row per pair, with the number of trials that would detect the difference.

    Args:
        evidence: the results of a group by one measure.
        learned: whether that is what was learned.

    """
    labels = evidence.group.labels
    short = {label: evidence.group.short(name) for name, label in labels.items()}
    by = f" {evidence.group.parameter}" if evidence.group.parameter else ""
    records = []
    scores = {(s.a, s.b): s for s in evidence.scores}
    for c in evidence.comparisons:
        needed = trials_to_settle(c.difference, 0.0, min(c.n_a, c.n_b))
        record = {"experiment": evidence.group.experiment} | c.row()
        named = {"a": labels[c.a], "b": labels[c.b], "winner": labels.get(c.winner or "")}
        if (score := scores.get((c.a, c.b))) is not None:
            record |= flat({"score_difference": score.difference, "score_p_holm": score.p_holm})
            record["higher_score"] = labels.get(score.winner or "")
        records.append(record | named | {"trials_needed": needed})
    columns = [
        Column("a", f"first{by}", lambda r: short[r["a"]]),
        Column("b", f"second{by}", lambda r: short[r["b"]]),
        Column("winner", "faster", lambda r: short.get(r["winner"], _undecided(r))),
        Column("difference", "first − second, iterations", _interval("difference", _count), True),
        Column("p_holm", "p (Holm)", lambda r: _p(r["p_holm"]), True),
        Column("score_difference", "first − second, score", _difference, True),
        Column("p_logrank", "p (log-rank)", lambda r: _p(r["p_logrank"]), True),
        Column("better", "first is faster in", _interval("better", _percent), True),
        Column("variance_ratio", "variance kept by pairing",
               lambda r: _plain(r["variance_ratio"], 2), True),
        Column("n_a", "pairs or trials", lambda r: f"{min(r['n_a'], r['n_b']):,}", True),
        Column("trials_needed", "trials for 80 % power", _needed, True),
    ]  # fmt: skip
    planned = evidence.group.crossed is not None or evidence.group.plane is not None
    title = f"{evidence.group.title}: {'planned pairs' if planned else 'all pairs'}"
    if learned:
        title += ", by what was learned"
    end = "pairs-learned" if learned else "pairs"
    return Table(f"{evidence.group.id}-{end}", title, columns, records, main=True)


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
                    "restricted_mean": summary.restricted_mean.value,
                    "restricted_mean_low": summary.restricted_mean.low,
                    "restricted_mean_high": summary.restricted_mean.high,
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


def _cell(s: Summary) -> str:
    middle = number(s.median.value) if s.median.value < float("inf") else "not reached"
    low, high = 100 * s.pass_rate.low, 100 * s.pass_rate.high
    mean = s.restricted_mean
    return (
        f"{s.converged} of {s.n} ({low:.0f} to {high:.0f} %)\nmean {mean.value:,.0f}"
        f" ({mean.low:,.0f} to {mean.high:,.0f})\nmedian {middle}"
    )


def jobs_table(evidence: Evidence) -> Table:
    """One row per job, with the command that repeats it."""
    records = []
    for part in evidence.groups:
        for c in part.group.configurations:
            for job in part.group.jobs[c.name]:
                o, source = job.outcomes, job.outcomes.provenance
                first, last = int(o.trial.min()), int(o.trial.max())
                records.append(
                    {
                        "experiment": o.experiment,
                        "job": o.name,
                        "configuration": part.group.labels[c.name],
                        "seed": source.get("seed"),
                        "trials": len(o),
                        "first_trial": first,
                        "last_trial": last,
                        "cap": o.cap,
                        "threshold": o.threshold,
                        "window": o.window,
                        "environment": part.group.environment,
                        "collector": source.get("collector"),
                        "batch_seconds": _number(source.get("seconds")),
                        "command": " ".join(("trl-explore train", *_shown(job.command))),
                    }
                )
    unique = list({(r["experiment"], r["job"], str(r)): r for r in records}.values())
    columns = [
        Column("experiment", "experiment", lambda r: str(r["experiment"])),
        Column("configuration", "configuration", lambda r: r["configuration"]),
        Column("seed", "seed", lambda r: str(r["seed"]), True),
        Column("trials", "trials", lambda r: f"{r['trials']:,}", True),
        Column("first_trial", "indices", lambda r: f"{r['first_trial']}–{r['last_trial']}", True),
        Column("cap", "cap", lambda r: f"{r['cap']:,}", True),
        Column("environment", "environment", lambda r: str(r["environment"])),
        Column("collector", "collector", lambda r: str(r["collector"])),
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


def _shown(command: Sequence[str]) -> list[str]:
    """The overrides without those for output, threads and restart, quoted for a shell."""
    skipped = ("output_dir=", "threads=", "restart=")
    return [_quoted(word) for word in command if not word.startswith(skipped)]


def _quoted(word: str) -> str:
    safe = all(ch.isalnum() or ch in "=,.+-_/:@" for ch in word)
    return word if safe else "'" + word.replace("'", "'\\''") + "'"


def _interval(key: str, text: Any, infinite: str = "∞") -> Any:
    def write(r: Record) -> str:
        value, low, high = r[key], r[f"{key}_low"], r[f"{key}_high"]
        main = infinite if value == math.inf else text(value)
        if value is None or math.isnan(value):
            return "–"
        if math.isnan(low) or math.isnan(high) or low == math.inf or (low, high) == UNKNOWN:
            return main
        if low == -math.inf:
            return f"{main}\n{text(high)} or less"
        if high == math.inf:
            return f"{main}\n{text(low)} or more"
        return f"{main}\n{text(low)} to {text(high)}"

    return write


def _passed(measure: str) -> Callable[[Record], str]:
    def write(r: Record) -> str:
        low, high = 100 * r[f"{measure}pass_rate_low"], 100 * r[f"{measure}pass_rate_high"]
        diverged = f", {r['diverged']} diverged" if r["diverged"] else ""
        return f"{r[f'{measure}converged']} of {r['n']}{diverged}\n{low:.0f} to {high:.0f} %"

    return write


def _seconds(r: Record) -> str:
    return f"{r['seconds_mean']:.3g}\n{r['timed']} timed" if r["timed"] else "–"


def _undecided(r: Record) -> str:
    if r["sd"] == 0 and r["difference"] == 0:  # in every trial
        return "neither passes" if r["mean_a"] == r["cap"] else "identical"
    return "not significant"


def _needed(r: Record) -> str:
    return trials_text(r["trials_needed"], "–")


def _count(x: float) -> str:
    return f"{x:,.0f}".replace("-", "−")


def _score(x: float) -> str:
    return f"{x:,.1f}".replace("-", "−") if abs(x) >= 9.995 else figure(x)


def _percent(x: float) -> str:
    return f"{100 * x:.0f} %"


def _plain(x: float, digits: int) -> str:
    return "–" if np.isnan(x) else f"{x:.{digits}f}".replace("-", "−")


def _difference(r: Record) -> str:
    if "score_difference" not in r:
        return "–"
    return f"{_interval('score_difference', _score)(r)}\np {_p(r['score_p_holm'])}"


def _p(p: float) -> str:
    return "< 0.001" if p < 0.001 else number(round(p, 3))


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) else None
