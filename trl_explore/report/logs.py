"""The page on runs that other programs wrote."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from importlib.resources import files
from math import inf, isfinite, isnan
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from scipy import stats

from trl_explore.logs.measures import Configuration, Task, by_configuration, profile, seeds_text
from trl_explore.logs.runs import Run
from trl_explore.report.build import PAGE, TABLES, _clear, _fresh, _write, _write_table
from trl_explore.report.figures.axes import handle, legend_above, new_figure, number, plain_numbers
from trl_explore.report.page import environment
from trl_explore.report.style import INK, Style, drawn_files, styles, theme_css, visual_language
from trl_explore.report.tables import Column, Record, Table
from trl_explore.statistics.comparisons import Comparison, Measure, compare_pairs
from trl_explore.statistics.estimates import LEVEL, Estimate, flat, pass_rate
from trl_explore.statistics.means import mean_interval
from trl_explore.statistics.power import fewest_pairs, trials_text, trials_to_settle
from trl_explore.statistics.summary import interquartile_mean
from trl_explore.statistics.survival import median_time

PERCENT = f"{100 * LEVEL:g} %"


@dataclass(frozen=True)
class Picture:
    """A figure of the page."""

    id: str
    title: str
    caption: str
    alt: str
    svg: str
    png: bytes
    pdf: bytes


@dataclass(frozen=True)
class Section:
    """What the page says about one environment."""

    id: str
    title: str
    answer: Sequence[str]
    notes: Sequence[str]
    figures: Sequence[Picture]
    tables: Sequence[Table]


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
        figures = [*_figures(task, id, looks)]
    tables = [_summary(task, id)]
    tables += [_pairs(task, measure, table, f"{id}-pairs-{k + 1}")
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
        f"{c.winner} {better} {measure.name} than {loser}: {_number(means[0])} against"
        f" {_number(means[1])} on average, a difference of {_text(c.difference)}"
        f" ({_equals(c.p_holm)}, {_design(c)})."
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
            f" {table[0].b}: {_text(table[0].difference)} ({_design(table[0])})."
        )
    return f"No difference in {measure.name} is established in any of {len(table)} pairs."


def _design(c: Comparison) -> str:
    if c.design == "paired":
        return f"{c.n_a} pairs by seed"
    return f"{c.n_a} and {c.n_b} runs"


def _summary(task: Task, id: str) -> Table:
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


def _pairs(task: Task, measure: Measure, table: Sequence[Comparison], id: str) -> Table:
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
        Column("p_holm", "p (Holm)", lambda r: _p(r["p_holm"]), True),
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


def _figures(task: Task, id: str, looks: dict[str, Style]) -> list[Picture]:
    bands = f"Bands: {PERCENT} intervals, at each step on its own."
    drawn = [
        ("curves", "Learning curves",
         f"Mean score of the runs by step, smoothed as above. {bands}", _draw_curves),
    ]  # fmt: skip
    if task.threshold is not None:
        drawn.append((
            "survival", f"Runs that have not exceeded {task.threshold:g}",
            "Kaplan–Meier. A curve that falls earlier and further is better. Runs that were cut off"
            f" are censored where they ended. {bands}", _draw_survival,
        ))  # fmt: skip
    drawn.append((
        "profile", "Performance profiles",
        f"Share of runs with a final score above the value on the axis; higher is better. {bands}",
        _draw_profile,
    ))  # fmt: skip
    return [_picture(f"{id}-{name}", title, text, task, looks, draw)
            for name, title, text, draw in drawn]  # fmt: skip


def _picture(
    id: str, title: str, caption: str, task: Task, looks: dict[str, Style],
    draw: Callable[[Axes, Configuration, Style], None],
) -> Picture:  # fmt: skip
    rows = (len(task.configurations) + 1) // 2
    figure = new_figure(2.8 + 0.17 * rows)
    ax = figure.subplots()
    for c in task.configurations:
        draw(ax, c, looks[c.name])
    steps = task.configurations[0].runs[0].step
    ax.set_xlabel("final score" if draw is _draw_profile else steps)
    if draw is _draw_curves:
        ax.set_ylabel("score")
        if task.threshold is not None:
            ax.axhline(task.threshold, color=INK, lw=0.8, ls=":")
    else:
        ax.set_ylim(-0.02, 1.02)
        ax.set_yticks(np.linspace(0, 1, 5), ["0 %", "25 %", "50 %", "75 %", "100 %"])
    ax.grid()
    plain_numbers(ax.xaxis)
    entries = [handle(looks[c.name], c.name[:40]) for c in task.configurations]
    legend_above(ax, entries, 2 if max(len(c.name) for c in task.configurations) < 28 else 1)
    alt = f"{title} of {', '.join(c.name for c in task.configurations)}"
    return Picture(id, title, caption, alt, **drawn_files(figure))


def _draw_curves(ax: Axes, c: Configuration, look: Style) -> None:
    known = c.curves[np.isfinite(c.curves[:, 0])]
    if not len(known):
        return
    mean, n = known.mean(0), len(known)
    ax.plot(c.grid, mean, color=look.color, ls=look.line, marker=look.marker, markevery=50)
    if n > 1:
        half = stats.t.ppf((1 + LEVEL) / 2, n - 1) * known.std(0, ddof=1) / np.sqrt(n)
        ax.fill_between(c.grid, mean - half, mean + half, color=look.color, alpha=0.13, lw=0)


def _draw_survival(ax: Axes, c: Configuration, look: Style) -> None:
    curve, end = c.survival(), float(c.grid[-1])
    times, heights = np.append(curve.times, end), np.append(curve.survival, curve.survival[-1])
    low, high = np.append(curve.low, curve.low[-1]), np.append(curve.high, curve.high[-1])
    if curve.times[-1] < end:  # unknown after the last run was cut off
        times, heights, low, high = curve.times, curve.survival, curve.low, curve.high
    ax.fill_between(times, low, high, step="post", color=look.color, alpha=0.13, lw=0)
    ax.step(times, heights, where="post", color=look.color, ls=look.line)
    marks = np.linspace(0, times[-1], 8)
    ax.plot(marks, curve.at(marks), ls="", color=look.color, marker=look.marker)


def _draw_profile(ax: Axes, c: Configuration, look: Style) -> None:
    values = np.sort(c.final[np.isfinite(c.final)])
    if not len(values):
        return
    room = 0.04 * (np.ptp(values) or abs(values[0]) or 1.0)
    scores = np.unique(np.concatenate([[values[0] - room], values, [values[-1] + room]]))
    shares = profile(values, scores)
    ax.step(scores, [s.value for s in shares], where="post", color=look.color, ls=look.line)
    ax.plot(values, [s.value for s in profile(values, values)], ls="", color=look.color,
            marker=look.marker)  # fmt: skip
    ax.fill_between(scores, [s.low for s in shares], [s.high for s in shares], step="post",
                    color=look.color, alpha=0.13, lw=0)  # fmt: skip


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


def estimate_cell(key: str, infinite: str = "∞") -> Callable[[Record], str]:
    """The text of an estimate in a table, with its interval in a second line."""

    def write(r: Record) -> str:
        e = Estimate(r[key], r[f"{key}_low"], r[f"{key}_high"])
        if isnan(e.value):
            return "–"
        main = infinite if e.value == inf else _number(e.value)
        if isnan(e.low) or isnan(e.high) or (e.low, e.high) == (-inf, inf):
            return main
        if not isfinite(e.high):
            return f"{main}\n{_number(e.low)} or more"
        return f"{main}\n{_number(e.low)} to {_number(e.high)}"

    return write


def _text(e: Estimate) -> str:
    if not (isfinite(e.low) and isfinite(e.high)):
        return _number(e.value)
    return f"{_number(e.value)} [{_number(e.low)}, {_number(e.high)}]"


def _number(x: float) -> str:
    digits = 0 if abs(x) >= 100 else 1 if abs(x) >= 10 else 2 if abs(x) >= 1 else 3
    text = f"{x:,.{digits}f}"
    return re.sub(r"^-(?=[0.,]*$)", "", text).replace("-", "−")


def _p(p: float) -> str:
    return "< 0.001" if p < 0.001 else number(round(p, 3))


def _equals(p: float) -> str:
    return "p < 0.001" if p < 0.001 else f"p = {_p(p)}"


def _file(name: str) -> str:
    return files("trl_explore.report").joinpath(name).read_text(encoding="utf-8")
