"""The page of ``trl-explore tune``: the sensitivity of each strategy, and the tuned ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trl_explore.names import strategy_label
from trl_explore.report.figures import Picture
from trl_explore.report.figures.axes import handle, legend_above, new_figure, plain_numbers
from trl_explore.report.log_tables import PERCENT, estimate_cell
from trl_explore.report.logs import Section, write_page
from trl_explore.report.style import drawn_files, styles, visual_language
from trl_explore.report.tables import Column, Table
from trl_explore.statistics.comparisons import Comparison, Measure, compare_all
from trl_explore.statistics.estimates import Estimate, flat
from trl_explore.statistics.means import mean_interval
from trl_explore.statistics.outcomes import Outcomes

Settings = Mapping[str, float]
"""Parameter -> its value."""


@dataclass(frozen=True)
class Tuned:
    """One strategy: every setting that was tried, and the best of them on other seeds.

    Attributes:
        strategy: its name.
        tried: every setting, with its trials on the tuning seed.
        picked: the position of the best of them.
        judged: the trials of the picked setting on the judging seed.
    """

    strategy: str
    tried: Sequence[tuple[Settings, Outcomes]]
    picked: int
    judged: Outcomes

    @property
    def settings(self) -> Settings:
        """The picked setting."""
        return self.tried[self.picked][0]

    def slice(self, parameter: str) -> list[tuple[float, Outcomes]]:
        """The settings that differ from the picked one in one parameter at most, in its order."""
        own = {key: value for key, value in self.settings.items() if key != parameter}
        return sorted(
            (
                (setting[parameter], outcomes)
                for setting, outcomes in self.tried
                if parameter in setting and own.items() <= setting.items()
            ),
            key=lambda pair: pair[0],
        )

    def at_edge(self) -> list[str]:
        """The parameters whose picked value is the smallest or largest that was tried."""
        return [
            key
            for key, value in self.settings.items()
            if len(values := {s[key] for s, _ in self.tried}) > 1
            and value in (min(values), max(values))
        ]


def build_page(
    tuned: Sequence[Tuned], measure: Measure, out: Path, *, tuning: int, judging: int
) -> Path:
    """Write the page; return its path.

    Args:
        tuned: the strategies.
        measure: in which they were tuned and are compared.
        out: folder of the page.
        tuning: seed on which settings were picked.
        judging: seed on which the picked ones are compared.
    """
    table = compare_all([t.judged for t in tuned], measure)
    labels = {t.judged.name: strategy_label(t.strategy) for t in tuned}
    picked, tried = _picked_table(tuned, measure), _tried_table(tuned, measure)
    pairs = _pairs_table(table, labels)
    section = Section(
        "answer",
        "The tuned strategies, on other seeds" if tuning != judging else "The tuned strategies",
        [_sentence(c, measure, labels) for c in table] or ["There is only one strategy."],
        warnings(tuned, tuning, judging),
        list(_figures(tuned, measure)),
        [pairs],
    )
    return write_page(
        out,
        [section],
        [picked, tried, pairs],
        title=f"{' and '.join(strategy_label(t.strategy) for t in tuned)}, each tuned",
        heading="What was tuned",
        facts=f"{sum(len(t.tried) for t in tuned)} settings,"
        f" {len(tuned[0].tried[0][1])} trials of each; {len(tuned[0].judged)} trials of the best.",
        setup=[
            ("tuned on", f"seed {tuning}"),
            ("judged on", f"seed {judging}"),
            ("objective", f"mean {measure.name}, {'least' if measure.less_is_better else 'most'}"),
        ],
        groups=picked,
        runs=tried,
        method=[
            "Every strategy was run with every combination of its own parameters and the learning"
            f" rate. The setting with the best mean {measure.name} was run again with another"
            " seed, and only those trials are compared: the best of many noisy means looks better"
            " than it is, and the more so the more settings a strategy has.",
            "Differences of means, in pairs of trials with the same seed and index, with intervals"
            " that allow for failures that were not seen, and Holm's correction.",
        ],
        limits=[
            "Whether a setting that was not tried is better.",
            "How the strategies compare with one common learning rate: each has its own.",
        ],
    )


def warnings(tuned: Sequence[Tuned], tuning: int, judging: int) -> list[str]:
    """What may make the comparison unfair, one sentence each."""
    found = []
    if tuning == judging:
        found.append(
            "Warning: the settings were picked on the seeds that judge them. Every strategy looks"
            " better than it is, most of all the one with the most settings; use another seed."
        )
    for t in tuned:
        if edges := t.at_edge():
            found.append(
                f"Warning: the best {' and '.join(edges)} of {strategy_label(t.strategy)} is at the"
                " edge of what was tried; a value beyond may be better."
            )
    if len(counts := {len(t.tried) for t in tuned}) > 1:
        found.append(
            f"The strategies have {min(counts)} to {max(counts)} settings: more settings, more"
            " chances on the tuning seed."
        )
    return found


def _mean(measure: Measure, outcomes: Outcomes) -> Estimate:
    sample = measure.of(outcomes)
    nothing = Estimate(np.nan, np.nan, np.nan)
    return mean_interval(sample) if len(sample) else nothing


def _number(x: float) -> str:
    return "–" if np.isnan(x) else f"{x:,.4g}".replace("-", "−")


def _setting(settings: Settings) -> str:
    return ", ".join(f"{key} = {value:g}" for key, value in settings.items())


def _picked_table(tuned: Sequence[Tuned], measure: Measure) -> Table:
    records = [
        {
            "strategy": strategy_label(t.strategy), "setting": _setting(t.settings),
            "tried": len(t.tried), "tuning": _mean(measure, t.tried[t.picked][1]).value,
            **flat({"judging": _mean(measure, t.judged)}),
        }
        for t in tuned
    ]  # fmt: skip
    columns = [
        Column("strategy", "strategy", lambda r: str(r["strategy"])),
        Column("tried", "settings", lambda r: str(r["tried"]), True),
        Column("setting", "best", lambda r: str(r["setting"])),
        Column("tuning", f"{measure.name}, tuning seed", lambda r: _number(r["tuning"]), True),
        Column("judging", f"{measure.name}, judging seed", estimate_cell("judging"), True),
    ]
    return Table("tuned", "The best setting of each strategy", columns, records, main=True)


def _tried_table(tuned: Sequence[Tuned], measure: Measure) -> Table:
    records = [
        {"strategy": strategy_label(t.strategy), **settings, "setting": _setting(settings)}
        | flat({"mean": _mean(measure, outcomes)})
        for t in tuned
        for settings, outcomes in t.tried
    ]
    columns = [
        Column("strategy", "strategy", lambda r: str(r["strategy"])),
        Column("setting", "setting", lambda r: str(r["setting"])),
        Column("mean", f"mean {measure.name}", estimate_cell("mean"), True),
    ]
    return Table("tried", "All settings, on the tuning seed", columns, records)


def _pairs_table(table: Sequence[Comparison], labels: Mapping[str, str]) -> Table:
    columns = [
        Column("a", "first", lambda r: labels[r["a"]]),
        Column("b", "second", lambda r: labels[r["b"]]),
        Column("winner", "better", lambda r: labels.get(r["winner"], "not established")),
        Column("difference", "first − second", estimate_cell("difference"), True),
        Column("p_holm", "p (Holm)", lambda r: f"{r['p_holm']:.3f}", True),
    ]  # fmt: skip
    return Table("pairs", "The tuned strategies: all pairs", columns, [c.row() for c in table],
                 main=True)  # fmt: skip


def _sentence(c: Comparison, measure: Measure, labels: Mapping[str, str]) -> str:
    d = c.difference
    numbers = f"{_number(c.mean_a)} and {_number(c.mean_b)}, difference {_number(d.value)}"
    numbers += f" [{_number(d.low)}, {_number(d.high)}]"
    if c.winner is None:
        return (
            f"No difference in {measure.name} is established between {labels[c.a]} and"
            f" {labels[c.b]}, each tuned: {numbers}."
        )
    word = "fewer" if measure.less_is_better else "a higher"
    loser = labels[c.b if c.winner == c.a else c.a]
    return f"{labels[c.winner]} has {word} {measure.name} than {loser}, each tuned: {numbers}."


def _figures(tuned: Sequence[Tuned], measure: Measure) -> Sequence[Picture]:
    parameters = dict.fromkeys(key for t in tuned for key in t.settings)
    looks = styles([t.strategy for t in tuned])
    found = []
    for k, parameter in enumerate(parameters):
        lines = [
            (t, look, points)
            for t, look in zip(tuned, looks, strict=True)
            if len(points := t.slice(parameter) if parameter in t.settings else []) > 1
        ]
        if not lines:
            continue
        with visual_language():
            figure = new_figure(2.9)
            ax = figure.subplots()
            for t, look, points in lines:
                x = np.array([value for value, _ in points])
                means = [_mean(measure, outcomes) for _, outcomes in points]
                y, low, high = np.array([(e.value, e.low, e.high) for e in means]).T
                ax.plot(x, y, color=look.color, ls=look.line, marker=look.marker)
                finite = np.isfinite(low) & np.isfinite(high)
                ax.fill_between(x[finite], low[finite], high[finite], color=look.color,
                                alpha=0.13, lw=0)  # fmt: skip
                best = list(x).index(t.settings[parameter])
                ax.plot(x[best], y[best], "o", ms=11, mfc="none", mec=look.color)
            values = np.concatenate([[v for v, _ in points] for *_, points in lines])
            if values.min() > 0 and values.max() / values.min() > 8:
                ax.set_xscale("log")
            ax.set_xlabel(parameter)
            ax.set_ylabel(f"mean {measure.name}")
            ax.grid()
            plain_numbers(ax.xaxis)
            legend_above(ax, [handle(look, strategy_label(t.strategy)) for t, look, _ in lines], 2)
            formats = drawn_files(figure)
        names = ", ".join(strategy_label(t.strategy) for t, *_ in lines)
        found.append(
            Picture(
                f"sensitivity-{k + 1}",
                f"Sensitivity to {parameter}",
                f"Mean {measure.name} on the tuning seed, all other parameters at their best. The"
                f" ring is the value that was picked. Bands: {PERCENT} intervals.",
                f"Mean {measure.name} by {parameter}: {names}",
                **formats,
            )
        )
    return found
