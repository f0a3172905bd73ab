"""Tables of the page on runs of other programs, and how their numbers are written."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from math import inf, isfinite, isnan
from typing import Any

import numpy as np

from trl_explore.logs.measures import Task, by_configuration, seeds_text
from trl_explore.logs.runs import Run
from trl_explore.report.figures.axes import number
from trl_explore.report.tables import Column, Record, Table
from trl_explore.statistics.comparisons import Comparison, Measure
from trl_explore.statistics.estimates import LEVEL, Estimate, flat, pass_rate
from trl_explore.statistics.means import mean_interval
from trl_explore.statistics.power import fewest_pairs, trials_text, trials_to_settle
from trl_explore.statistics.summary import interquartile_mean
from trl_explore.statistics.survival import median_time

PERCENT = f"{100 * LEVEL:g} %"


def runs_table(runs: Sequence[Run]) -> Table:
    """One row for each run, with what was recognised and what was changed."""
    records = [
        {
            "run": run.place, "configuration": run.configuration, "environment": run.environment,
            "seed": run.seed, "points": len(run.curve), "last": run.curve.last, "used": run.used,
            "notes": "; ".join(run.notes),
        }
        for run in runs
    ]  # fmt: skip
    columns = [
        Column("run", "run", lambda r: str(r["run"]), wide=True),
        Column("configuration", "configuration", lambda r: str(r["configuration"])),
        Column("environment", "environment", lambda r: str(r["environment"] or "unknown")),
        Column("seed", "seed", lambda r: "unknown" if r["seed"] is None else str(r["seed"]), True),
        Column("points", "points", lambda r: f"{r['points']:,}", True),
        Column("last", "last step", lambda r: f"{r['last']:,.0f}", True),
        Column("notes", "notes", lambda r: str(r["notes"]), wide=True),
    ]
    return Table("runs", "All runs", columns, records)


def groups_table(runs: Sequence[Run]) -> Table:
    """One row for each configuration of each environment."""
    records = [
        {
            "environment": name or "unknown", "configuration": configuration, "runs": len(group),
            "seeds": seeds_text(group),
            "first_last": min(r.curve.last for r in group),
            "last_last": max(r.curve.last for r in group),
        }
        for (name, configuration), group in by_configuration(runs).items()
    ]  # fmt: skip
    columns = [
        Column("environment", "environment", lambda r: str(r["environment"])),
        Column("configuration", "configuration", lambda r: str(r["configuration"])),
        Column("runs", "runs", lambda r: str(r["runs"]), True),
        Column("seeds", "seeds", lambda r: str(r["seeds"])),
        Column("last_last", "last step", _range, True),
    ]
    return Table("configurations", "Configurations", columns, records)


def _range(r: Record) -> str:
    low, high = f"{r['first_last']:,.0f}", f"{r['last_last']:,.0f}"
    return high if low == high else f"{low} to {high}"


def summary_table(task: Task, id: str) -> Table:
    """One row for each configuration."""
    records = []
    for c in task.configurations:
        record: dict[str, Any] = {
            "configuration": c.name, "runs": len(c), "cut_off": int(c.cut.sum()),
            "diverged": int(c.diverged.sum()),
        }  # fmt: skip
        if task.threshold is not None:
            record |= {"passed": int(c.passed.sum())}
            record |= {
                "pass_rate": pass_rate(int(c.passed.sum()), len(c)),
                "median": median_time(c.survival()),
            }
            record["mean_steps"] = _mean(c.times())
        final = c.sample(c.final)
        record |= {"final": _mean(final), "area": _mean(c.sample(c.area))}
        record["iqm"] = interquartile_mean(final.values) if len(final) else _nothing()
        records.append(flat(record))
    columns = [
        Column("configuration", "configuration", lambda r: str(r["configuration"])),
        Column("runs", "runs", lambda r: str(r["runs"]), True),
    ]
    if task.threshold is not None:
        columns += [
            Column("pass_rate", f"exceeded {task.threshold:g}", _passed, True),
            Column("median", "median steps", estimate_cell("median", "not reached"), True),
            Column("mean_steps", "mean steps", estimate_cell("mean_steps"), True),
        ]
    columns += [
        Column("final", "final score, mean", estimate_cell("final"), True),
        Column("iqm", "final score, IQM", estimate_cell("iqm"), True),
        Column("area", "area under the curve", estimate_cell("area"), True),
    ]
    title = f"Configurations, with {PERCENT} intervals"
    return Table(f"{id}-configurations", title, columns, records, main=True)


def _mean(sample: Any) -> Estimate:
    return mean_interval(sample) if len(sample) else _nothing()


def _nothing() -> Estimate:
    return Estimate(np.nan, np.nan, np.nan)


def _passed(r: Record) -> str:
    low, high = 100 * r["pass_rate_low"], 100 * r["pass_rate_high"]
    return f"{r['passed']} of {r['runs']}\n{low:.0f} to {high:.0f} %"


def pairs_table(task: Task, measure: Measure, table: Sequence[Comparison], id: str) -> Table:
    """One row for each pair, in one measure."""
    records = [
        {"environment": task.environment} | c.row()
        | {"seeds_needed": _needed(c)}
        for c in table
    ]  # fmt: skip
    columns = [
        Column("a", "first", lambda r: str(r["a"])),
        Column("b", "second", lambda r: str(r["b"])),
        Column("winner", "better", lambda r: r["winner"] or "not established"),
        Column("difference", "first − second", estimate_cell("difference"), True),
        Column("p_holm", "p (Holm)", lambda r: p_text(r["p_holm"]), True),
        Column("better", "first is better in", _share, True),
        Column("n_a", "compared", _compared, True),
        Column("seeds_needed", "seeds for 80 % power",
               lambda r: trials_text(r["seeds_needed"], "–"), True),
    ]  # fmt: skip
    title = f"{measure.name[0].upper()}{measure.name[1:]}: all pairs"
    return Table(id, title, columns, records, main=True)


def _needed(c: Comparison) -> float | None:
    needed = trials_to_settle(c.difference, 0.0, min(c.n_a, c.n_b))
    return None if needed is None else max(needed, fewest_pairs())


def _share(r: Record) -> str:
    value, low, high = (100 * r[f"better{end}"] for end in ("", "_low", "_high"))
    return f"{value:.0f} %\n{low:.0f} to {high:.0f} %"


def _compared(r: Record) -> str:
    kind = "pairs" if r["design"] == "paired" else f"and {r['n_b']} runs"
    return f"{r['n_a']} {kind}" + (f"\n{r['dropped']} left out" if r["dropped"] else "")


def estimate_cell(key: str, infinite: str = "∞") -> Callable[[Record], str]:
    """The text of an estimate in a table, with its interval in a second line."""

    def write(r: Record) -> str:
        e = Estimate(r[key], r[f"{key}_low"], r[f"{key}_high"])
        if isnan(e.value):
            return "–"
        main = infinite if e.value == inf else number_text(e.value)
        if isnan(e.low) or isnan(e.high) or (e.low, e.high) == (-inf, inf):
            return main
        if not isfinite(e.high):
            return f"{main}\n{number_text(e.low)} or more"
        return f"{main}\n{number_text(e.low)} to {number_text(e.high)}"

    return write


def estimate_text(e: Estimate) -> str:
    """An estimate in a sentence, with its interval if that is known."""
    if not (isfinite(e.low) and isfinite(e.high)):
        return number_text(e.value)
    return f"{number_text(e.value)} [{number_text(e.low)}, {number_text(e.high)}]"


def number_text(x: float) -> str:
    """A number with three significant digits or all before the point."""
    digits = 0 if abs(x) >= 100 else 1 if abs(x) >= 10 else 2 if abs(x) >= 1 else 3
    text = f"{x:,.{digits}f}"
    return re.sub(r"^-(?=[0.,]*$)", "", text).replace("-", "−")


def p_text(p: float) -> str:
    """A p-value in a cell."""
    return "< 0.001" if p < 0.001 else number(round(p, 3))


def p_equals(p: float) -> str:
    """A p-value in a sentence."""
    return "p < 0.001" if p < 0.001 else f"p = {p_text(p)}"
