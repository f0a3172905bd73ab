"""The page on runs that other programs wrote."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from math import nan
from pathlib import Path
from typing import Any

from trl_explore.logs.measures import Task, by_configuration, seeds_text
from trl_explore.logs.readers import Run
from trl_explore.report.figures import Picture
from trl_explore.report.figures.logs import task_figures
from trl_explore.report.page import render
from trl_explore.report.results_tables import pair_columns, pair_records
from trl_explore.report.style import styles, visual_language
from trl_explore.report.table_formats import (
    Column,
    Record,
    Table,
    estimate_cell,
    estimates,
    interval,
    negated,
    p_value,
    plain_columns,
    rate_cell,
    rounded,
)
from trl_explore.report.writing import write_page
from trl_explore.statistics.comparisons import Comparison, Measure, compare_all, too_few
from trl_explore.statistics.estimates import LEVEL, Estimate, flat, pass_rate
from trl_explore.statistics.means import mean_interval
from trl_explore.statistics.samples import Sample
from trl_explore.statistics.summary import interquartile_mean
from trl_explore.statistics.survival import kaplan_meier, median_time


@dataclass(frozen=True)
class Section:
    """What the page says about one environment."""

    id: str
    title: str
    answer: Sequence[str]
    notes: Sequence[str]
    figures: Sequence[Picture]
    tables: Sequence[Table]


def build_page(
    runs: Sequence[Run],
    found: Sequence[Task],
    out: Path,
    *,
    source: str,
    others: Sequence[str] = (),
) -> Path:
    """Write the page with its figures and tables; return its path.

    Args:
        runs: all runs.
        found: their measures, for each environment.
        out: folder of the page.
        source: the program that wrote the runs.
        others: the other quantities that all runs logged.

    Raises:
        ResultsError: the folder is a link.
    """
    sections = [_section(task, f"environment-{k + 1}") for k, task in enumerate(found)]
    used = sum(run.used for run in runs)
    return write_sections(
        out,
        sections,
        groups=groups_table(runs),
        runs=runs_table(runs),
        title=_title(found),
        heading="What was read",
        facts=f"{used} runs, {len(by_configuration(runs))} configurations, one number of each run"
        " in every test.",
        setup=_setup(runs, found, source, others),
        timed=any(task.threshold is not None for task in found),
        level=f"{100 * LEVEL:g} %",
        versions=[f"{name} {version(name)}" for name in ("trl_explore", "numpy", "scipy")],
        most=max(len(c) for task in found for c in task.configurations),
        powered=any(r.get("trials_needed") for s in sections for t in s.tables for r in t.records),
    )


def write_sections(
    out: Path,
    sections: Sequence[Section],
    *,
    groups: Table,
    runs: Table,
    template: str = "logs.html",
    **parts: Any,
) -> Path:
    """Write a page with its figures and tables; return its path."""
    figures = [f for section in sections for f in section.figures]
    tables = [groups, runs, *(t for section in sections for t in section.tables)]
    html = render(template, figures, sections=sections, groups=groups, runs=runs, **parts)
    return write_page(out, html, figures, tables)


def _title(found: Sequence[Task]) -> str:
    names = list(dict.fromkeys(c.name for task in found for c in task.configurations))
    tasks = [task.environment for task in found if task.environment]
    where = f" in {', '.join(tasks)}" if 0 < len(tasks) <= 2 else ""
    return f"{' and '.join(names) if len(names) <= 3 else f'{len(names)} configurations'}{where}"


def _setup(
    runs: Sequence[Run], found: Sequence[Task], source: str, others: Sequence[str]
) -> list[tuple[str, str]]:
    of = "episodes" if runs[0].episodes else "points"
    levels = {"" if t.threshold is None else f"> {t.threshold:g}" for t in found}
    if len(levels) > 1:
        levels = {f"{t.environment}: > {t.threshold:g}" for t in found if t.threshold is not None}
    windows = sorted({task.window for task in found})
    window = ", ".join(f"mean of the last {n} {of}" if n > 1 else "every point" for n in windows)
    horizons = {f"{task.environment or 'all'}: {task.horizon:,.0f}" for task in found}
    more = f" and {len(others) - 12} more" if len(others) > 12 else ""
    return [
        ("read with", f"--from {source}"),
        ("score", f"{runs[0].score}, {window}"),
        ("steps", runs[0].step),
        ("threshold", ", ".join(sorted(levels)) or "none: no times (--threshold)"),
        ("judged up to step", ", ".join(sorted(horizons))),
        *([("also logged, not used", ", ".join(others[:12]) + more)] if others else []),
    ]


def _section(task: Task, id: str) -> Section:
    names = [c.name for c in task.configurations]
    labels = {name: name for name in names}
    rows, notes, tables = [], list(task.notes), [summary_table(task, id)]
    for measure in task.measures():
        whole = [c.outcomes() for c in task.configurations]
        known = [o for o in whole if len(measure.of(o))]
        if lacking := [o.name for o in whole if o not in known]:
            notes.append(f"No run of {', '.join(lacking)} has {measure.name}.")
        if compared := compare_all(known, measure):
            rows.append((measure, compared))
            title = f"{measure.name[0].upper()}{measure.name[1:]}: all pairs"
            records = pair_records(compared, labels)
            tables.append(Table(f"{id}-pairs-{len(rows)}", title, pair_columns(), records,
                                main=True, kind="cards"))  # fmt: skip
    with visual_language():
        figures = task_figures(task, id, dict(zip(names, styles(names), strict=True)))
    title = task.environment or "All runs"
    return Section(id, title, _answer(task, rows), notes, figures, tables)


def _answer(task: Task, rows: Sequence[tuple[Measure, Sequence[Comparison]]]) -> list[str]:
    sentences = []
    if task.threshold is not None:
        shares = [f"{c.name} {int(c.passed.sum())} of {len(c)}" for c in task.configurations]
        sentences.append(
            f"Runs that exceeded {task.threshold:g} by step {task.horizon:,.0f}:"
            f" {', '.join(shares)}."
        )
    if len(task.configurations) < 2:
        return [*sentences, "There is only one configuration, so nothing is compared."]
    for measure, table in rows:
        won = sorted((c for c in table if c.winner), key=lambda c: c.p_value)
        most = max(min(c.n_a, c.n_b) for c in table)
        if won:
            more = f" Of {len(table)} pairs, {len(won)} differ." if len(table) > 1 else ""
            sentences.append(pair_sentence(won[0], measure) + more)
        elif fewest := too_few(table):
            paired = all(c.design == "paired" for c in table)
            design, units = ("pairs", "seeds") if paired else ("runs of each", "runs of each")
            corrected = f", corrected for {len(table)} comparisons," if len(table) > 1 else ""
            sentences.append(
                f"No difference in {measure.name} can be established: with {most} {design} none"
                f"{corrected} is ever significant at {100 * (1 - LEVEL):g} %; at least {fewest}"
                f" {units} are needed."
            )
        elif len(table) == 1:
            sentences.append(pair_sentence(table[0], measure))
        else:
            sentences.append(
                f"No difference in {measure.name} is established in any of {len(table)} pairs."
            )
    return sentences


def pair_sentence(c: Comparison, measure: Measure, labels: Mapping[str, str] | None = None) -> str:
    """The winner of a pair with the means and their difference, or that there is none."""
    name = labels or {c.a: c.a, c.b: c.b}
    design = f"{c.n_a} pairs by seed" if c.design == "paired" else f"{c.n_a} and {c.n_b} runs"
    if c.winner is None:
        return (
            f"No difference in {measure.name} is established between {name[c.a]} and {name[c.b]}:"
            f" {interval(c.difference)} ({design})."
        )
    (best, high), (rest, low) = sorted(
        ((c.a, c.mean_a), (c.b, c.mean_b)), key=lambda pair: pair[0] != c.winner
    )
    difference = c.difference if best == c.a else negated(c.difference)
    better = "takes fewer" if measure.less_is_better else "has a higher"
    return (
        f"{name[best]} {better} {measure.name} than {name[rest]}: {rounded(high)} against"
        f" {rounded(low)} on average, a difference of {interval(difference)}"
        f" (p {p_value(c.p_holm)}, {design})."
    )


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
        *plain_columns("configuration"),
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

    def last_step(r: Record) -> str:
        low, high = f"{r['first_last']:,.0f}", f"{r['last_last']:,.0f}"
        return high if low == high else f"{low} to {high}"

    columns = [
        *plain_columns("environment", "configuration"),
        Column("runs", "runs", lambda r: str(r["runs"]), True),
        *plain_columns("seeds"),
        Column("last_last", "last step", last_step, True),
    ]
    return Table("configurations", "Configurations", columns, records)


def summary_table(task: Task, id: str) -> Table:
    """One row for each configuration."""
    records = []
    for c in task.configurations:
        record: dict[str, Any] = {
            "configuration": c.name, "n": len(c), "cut_off": int(c.cut.sum()),
            "diverged": int(c.diverged.sum()),
        }  # fmt: skip
        if task.threshold is not None:
            record |= {
                "converged": int(c.passed.sum()),
                "pass_rate": pass_rate(int(c.passed.sum()), len(c)),
                "median": median_time(kaplan_meier(c.time, c.passed)),
                "mean_steps": sample_mean(c.times()),
            }
        final = c.sample(c.final)
        iqm = interquartile_mean(final.values) if len(final) else Estimate(nan, nan, nan)
        record |= {"final": sample_mean(final), "iqm": iqm, "area": sample_mean(c.sample(c.area))}
        records.append(flat(record))
    columns = [*plain_columns("configuration"), Column("n", "runs", lambda r: str(r["n"]), True)]
    if task.threshold is not None:
        columns += [
            Column("pass_rate", f"exceeded {task.threshold:g}", rate_cell(), True),
            Column("median", "median steps", estimate_cell("median", infinite="not reached"), True),
            Column("mean_steps", "mean steps", estimate_cell("mean_steps"), True),
        ]
    titles = {
        "final": "final score, mean",
        "iqm": "final score, IQM",
        "area": "area under the curve",
    }
    columns += estimates(titles)
    title = f"Configurations, with {100 * LEVEL:g} % intervals"
    return Table(f"{id}-configurations", title, columns, records, main=True, kind="cards")


def sample_mean(sample: Sample) -> Estimate:
    """The mean with its interval; NaN without trials."""
    return mean_interval(sample) if len(sample) else Estimate(nan, nan, nan)
