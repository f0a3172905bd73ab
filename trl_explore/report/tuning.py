"""The page of ``trl-explore tune``: the sensitivity of each strategy, and the tuned ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trl_explore.names import strategy_label
from trl_explore.report.figures import Picture
from trl_explore.report.figures.axes import handle, legend_above, new_figure, plain_numbers
from trl_explore.report.image_files import drawn_files
from trl_explore.report.other_programs import Section, pair_sentence, sample_mean, write_sections
from trl_explore.report.results_tables import pair_columns, pair_records
from trl_explore.report.style import styles, visual_language
from trl_explore.report.table_formats import Column, Table, estimates, plain_columns, rounded
from trl_explore.statistics.comparisons import Measure, compare_all
from trl_explore.statistics.estimates import LEVEL, flat
from trl_explore.statistics.outcomes import Outcomes

Settings = Mapping[str, float]
"""Parameter -> its value."""


@dataclass(frozen=True)
class Tuned:
    """One strategy: its settings with their trials on the tuning seed, and the picked one judged.

    ``picked`` is the position of the best setting, ``judged`` its trials on the judging seed.
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

    The strategies were tuned and are compared in one measure, on a seed each.
    """
    labels = {t.judged.name: strategy_label(t.strategy) for t in tuned}
    compared = compare_all([t.judged for t in tuned], measure)
    records = pair_records(compared, labels)
    section = Section(
        "answer",
        f"The tuned strategies{', on other seeds' if tuning != judging else ''}",
        [pair_sentence(c, measure, labels) for c in compared] or ["There is only one strategy."],
        warnings(tuned, tuning, judging),
        list(_figures(tuned, measure)),
        [Table("pairs", "The tuned strategies: all pairs", pair_columns(), records, main=True)],
    )
    return write_sections(
        out,
        [section],
        groups=_picked_table(tuned, measure),
        runs=_tried_table(tuned, measure),
        template="tuning.html",
        title=f"{' and '.join(strategy_label(t.strategy) for t in tuned)}, each tuned",
        heading="What was tuned",
        facts=f"{sum(len(t.tried) for t in tuned)} settings,"
        f" {len(tuned[0].tried[0][1])} trials of each; {len(tuned[0].judged)} trials of the best.",
        setup=[
            ("tuned on", f"seed {tuning}"),
            ("judged on", f"seed {judging}"),
            ("objective", f"mean {measure.name}, {'least' if measure.less_is_better else 'most'}"),
        ],
        measure=measure.name,
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


def _setting(settings: Settings) -> str:
    return ", ".join(f"{key} = {value:g}" for key, value in settings.items())


def _picked_table(tuned: Sequence[Tuned], measure: Measure) -> Table:
    records = [
        {
            "strategy": strategy_label(t.strategy), "setting": _setting(t.settings),
            "tried": len(t.tried), "tuning": sample_mean(measure.of(t.tried[t.picked][1])).value,
            **flat({"judging": sample_mean(measure.of(t.judged))}),
        }
        for t in tuned
    ]  # fmt: skip
    columns = [
        *plain_columns("strategy"),
        Column("tried", "settings", lambda r: str(r["tried"]), True),
        Column("setting", "best", lambda r: str(r["setting"])),
        Column("tuning", f"{measure.name}, tuning seed", lambda r: rounded(r["tuning"]), True),
        *estimates({"judging": f"{measure.name}, judging seed"}),
    ]
    return Table("tuned", "The best setting of each strategy", columns, records, main=True)


def _tried_table(tuned: Sequence[Tuned], measure: Measure) -> Table:
    records = [
        {"strategy": strategy_label(t.strategy), **settings, "setting": _setting(settings)}
        | flat({"mean": sample_mean(measure.of(outcomes))})
        for t in tuned
        for settings, outcomes in t.tried
    ]
    columns = [*plain_columns("strategy", "setting"), *estimates({"mean": f"mean {measure.name}"})]
    return Table("tried", "All settings, on the tuning seed", columns, records)


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
            drawn = new_figure(2.9)
            ax = drawn.subplots()
            for t, look, points in lines:
                x = np.array([value for value, _ in points])
                means = [sample_mean(measure.of(outcomes)) for _, outcomes in points]
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
            formats = drawn_files(drawn)
        names = ", ".join(strategy_label(t.strategy) for t, *_ in lines)
        found.append(
            Picture(
                f"sensitivity-{k + 1}",
                f"Sensitivity to {parameter}",
                f"Mean {measure.name} on the tuning seed, all other parameters at their best. The"
                f" ring is the value that was picked. Bands: {100 * LEVEL:g} % intervals.",
                f"Mean {measure.name} by {parameter}: {names}",
                **formats,
            )
        )
    return found
