"""The page on runs that other programs wrote."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

from markupsafe import Markup

from trl_explore.logs.measures import Task, by_configuration
from trl_explore.logs.runs import Run
from trl_explore.report.build import PAGE, TABLES, _clear, _fresh, _write, _write_table
from trl_explore.report.figures import Picture
from trl_explore.report.figures.logs import task_figures
from trl_explore.report.log_tables import (
    PERCENT,
    estimate_text,
    groups_table,
    number_text,
    p_equals,
    pairs_table,
    runs_table,
    summary_table,
)
from trl_explore.report.page import environment
from trl_explore.report.style import styles, theme_css, visual_language
from trl_explore.report.tables import Table
from trl_explore.statistics.comparisons import Comparison, Measure, compare_pairs
from trl_explore.statistics.estimates import LEVEL
from trl_explore.statistics.power import fewest_pairs


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
        others: quantities that all runs logged beside the score.

    Raises:
        ResultsError: the folder is a link.
    """
    sections = [_section(task, f"environment-{k + 1}") for k, task in enumerate(found)]
    used = [run for run in runs if run.used]
    tables = [runs_table(runs), groups_table(runs), *(t for s in sections for t in s.tables)]
    return write_page(
        out,
        sections,
        tables,
        title=_title(found),
        heading="What was read",
        facts=f"{len(used)} runs, {len(by_configuration(runs))} configurations, one number of"
        " each run in every test.",
        setup=_setup(runs, found, source, others),
        groups=tables[1],
        runs=tables[0],
        method=_method(found),
        limits=_limits(found),
    )


def write_page(
    out: Path, sections: Sequence[Section], tables: Sequence[Table], **parts: Any
) -> Path:
    """Write a page of ``logs.html`` with its figures and tables; return its path."""
    pictures = [figure for section in sections for figure in section.figures]
    template = environment().get_template("logs.html")
    html = template.render(
        css=Markup(_file("page.css") + theme_css(f.svg for f in pictures)),
        script=Markup(_file("page.js")),
        sections=sections,
        **parts,
    )
    _clear(out)
    for figure in pictures:
        _write(out / "figures" / f"{figure.id}.svg", figure.svg)
        _fresh(out / "figures" / f"{figure.id}.png").write_bytes(figure.png)
        _fresh(out / "figures" / f"{figure.id}.pdf").write_bytes(figure.pdf)
    for table in tables:
        _write_table(out / TABLES, table)
    _write(out / PAGE, html)
    return out / PAGE


def _title(found: Sequence[Task]) -> str:
    names = list(dict.fromkeys(c.name for task in found for c in task.configurations))
    tasks = [task.environment for task in found if task.environment]
    where = f" in {', '.join(tasks)}" if 0 < len(tasks) <= 2 else ""
    return f"{' and '.join(names) if len(names) <= 3 else f'{len(names)} configurations'}{where}"


def _setup(
    runs: Sequence[Run], found: Sequence[Task], source: str, others: Sequence[str]
) -> list[tuple[str, str]]:
    first = found[0]
    windows = sorted({task.window for task in found})
    of = "episodes" if runs[0].episodes else "points"
    window = ", ".join(f"mean of the last {n} {of}" if n > 1 else "every point" for n in windows)
    thresholds = (
        "none: no times (--threshold)" if first.threshold is None else f"> {first.threshold:g}"
    )
    horizons = {f"{task.environment or 'all'}: {task.horizon:,.0f}" for task in found}
    setup = [
        ("read with", f"--from {source}"),
        ("score", f"{runs[0].score}, {window}"),
        ("steps", runs[0].step),
        ("threshold", thresholds),
        ("judged up to step", ", ".join(sorted(horizons))),
    ]
    if others:
        more = f" and {len(others) - 12} more" if len(others) > 12 else ""
        setup.append(("also logged, not used", ", ".join(others[:12]) + more))
    return setup


def _section(task: Task, id: str) -> Section:
    names = [c.name for c in task.configurations]
    looks = dict(zip(names, styles(names), strict=True))
    rows, notes = [], list(task.notes)
    for measure in task.measures():
        table, missing = _compare(task, measure)
        rows += [(measure, table)] if table else []
        notes += missing
    with visual_language():
        figures = [*task_figures(task, id, looks)]
    tables = [summary_table(task, id)]
    tables += [pairs_table(task, measure, table, f"{id}-pairs-{k + 1}")
               for k, (measure, table) in enumerate(rows)]  # fmt: skip
    title = task.environment or "All runs"
    return Section(id, title, _answer(task, rows), notes, figures, tables)


def _compare(task: Task, measure: Measure) -> tuple[list[Comparison], list[str]]:
    """All pairs of configurations of which at least one run has the measure."""
    whole = [(c.outcomes(), measure.of(c.outcomes())) for c in task.configurations]
    known = [outcomes for outcomes, sample in whole if len(sample)]
    lacking = [o.name for o, sample in whole if not len(sample)]
    pairs = [(a, b) for i, a in enumerate(known) for b in known[i + 1 :]]
    notes = [f"No run of {', '.join(lacking)} has {measure.name}."] if lacking else []
    return compare_pairs(pairs, measure), notes


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
        won = [c for c in table if c.winner]
        won.sort(key=lambda c: c.p_value)
        if not won:
            sentences.append(_undecided(measure, table))
        else:
            more = f" Of {len(table)} pairs, {len(won)} differ." if len(table) > 1 else ""
            sentences += [_won(measure, won[0]) + more]
    return sentences


def _won(measure: Measure, c: Comparison) -> str:
    loser = c.b if c.winner == c.a else c.a
    means = (c.mean_a, c.mean_b) if c.winner == c.a else (c.mean_b, c.mean_a)
    better = "takes fewer" if measure.less_is_better else "has a higher"
    return (
        f"{c.winner} {better} {measure.name} than {loser}: {number_text(means[0])} against"
        f" {number_text(means[1])} on average, a difference of {estimate_text(c.difference)}"
        f" ({p_equals(c.p_holm)}, {_design(c)})."
    )


def _undecided(measure: Measure, table: Sequence[Comparison]) -> str:
    most, fewest = max(min(c.n_a, c.n_b) for c in table), fewest_pairs()
    if all(c.design == "paired" for c in table) and most < fewest:
        return (
            f"No difference in {measure.name} can be established: with {most} pairs none is ever"
            f" significant at {100 * (1 - LEVEL):g} %; at least {fewest} seeds are needed."
        )
    if len(table) == 1:
        return (
            f"No difference in {measure.name} is established between {table[0].a} and"
            f" {table[0].b}: {estimate_text(table[0].difference)} ({_design(table[0])})."
        )
    return f"No difference in {measure.name} is established in any of {len(table)} pairs."


def _design(c: Comparison) -> str:
    if c.design == "paired":
        return f"{c.n_a} pairs by seed"
    return f"{c.n_a} and {c.n_b} runs"


def _method(found: Sequence[Task]) -> list[str]:
    threshold = found[0].threshold
    times = (
        f" The time of a run is the first step at which its smoothed score exceeds {threshold:g};"
        " a run that does not exceed it is right-censored at the last step. The share of runs by"
        " step is Kaplan and Meier's estimate with a log-log interval; the mean of steps is"
        " restricted to the last step, with an interval that allows for failures that were not"
        " seen (MOVER: Zou and Donner 2008)."
        if threshold is not None
        else ""
    )
    return [
        "Every run gives one number to each test. All runs of an environment are judged over the"
        " same steps. The final score is the mean of the smoothed score over the last tenth of the"
        " steps; the area under the curve is its mean over all steps. Both count every step alike,"
        " whatever the distance of the logged points." + times,
        f"Intervals of means are Student's, at {PERCENT}. The interquartile mean (IQM) is the mean"
        " of the middle half of the runs, with the interval of Tukey and McLaughlin (1963);"
        " performance profiles and the IQM are those of Agarwal et al. (2021). Two configurations"
        " are compared by the difference of their means: in pairs of runs with the same seed, or,"
        " where no seed is shared, as independent samples. The test is the dual of the interval,"
        " and its p is at least 2 / 2ⁿ with n pairs. Within each table p is corrected by Holm's"
        " method, and each interval has the level of its step.",
        f"Made with trl_explore {version('trl_explore')}, numpy {version('numpy')} and scipy"
        f" {version('scipy')}.",
    ]


def _limits(found: Sequence[Task]) -> list[str]:
    limits = [
        "Whether the scores show what was learned or how the agent explored: that depends on what"
        " the program logged.",
        "Why configurations differ. If they differ in more than one setting, their settings are"
        " confounded.",
        "Anything about the behaviour policy, the states that were visited, or scores without"
        " exploration: these files do not hold them.",
    ]
    if len(found) > 1:
        limits.append(
            "Which configuration is best over all environments: their scores have no common scale."
        )
    most = max(len(c) for task in found for c in task.configurations)
    if most < 20:
        limits.append(
            f"Small differences: there are at most {most} runs of a configuration. The column"
            " “seeds for 80 % power” says how many would be needed."
        )
    return limits


def _file(name: str) -> str:
    return files("trl_explore.report").joinpath(name).read_text(encoding="utf-8")
