"""Which configurations stand side by side: those of one experiment, stopped by one rule."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from trl_explore.report.designs import Crossed, Plane, crossed, plane
from trl_explore.report.labels import (
    EXPERIMENTS,
    configuration_labels,
    natural_order,
    strategy_label,
    swept_parameter,
    swept_parameters,
    symbol,
)
from trl_explore.report.loading import Job, Timing
from trl_explore.report.style import Style, option_styles, styles
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import configuration_key, deduplicate, pool

GRIDS = ("epsilon_grid", "decay_grid", "temperature_grid")
ORDER = (
    "thesis", "corrections", "corrections_temperature", "", "epsilon_grid", "decay_grid",
    "temperature_grid", "mixture_plane", "baselines", "baselines_batch", "deep_policy",
    "frozenlake",
)  # fmt: skip
"""Of the experiments in a report; those without a place stand at the empty one."""


@dataclass(frozen=True, eq=False)
class Group:
    """Configurations that may be compared with each other.

    Attributes:
        id: unique, usable in file names.
        title: heading in the report.
        experiment: the sweep.
        cap: iterations.
        threshold: score above which a trial has passed.
        window: episodes that the final score averages over.
        environment: its id.
        configurations: in the order of the figures; each (seed, trial) once, seeds pooled.
        labels: name of a configuration -> what readers call it.
        styles: name of a configuration -> how it looks.
        jobs: name of a configuration -> the jobs that its trials come from.
        parameter: the one parameter in which the configurations differ, if there is one.
        crossed: their layout, where rows are crossed with the options of a group.
        plane: their layout, where they differ in two numbers.

    """

    id: str
    title: str
    experiment: str
    cap: int
    threshold: float
    window: int
    environment: str
    configurations: list[Outcomes]
    labels: dict[str, str]
    styles: dict[str, Style]
    jobs: dict[str, list[Job]]
    parameter: str | None
    crossed: Crossed | None = None
    plane: Plane | None = None

    @property
    def is_grid(self) -> bool:
        """Whether it is a grid over one parameter, as the thesis has two."""
        return self.experiment in GRIDS

    def short(self, name: str) -> str:
        """The label of a configuration beside an axis that already names the parameter."""
        return self.labels[name].removeprefix(f"{self.parameter} = ")

    def timing(self, name: str) -> Timing | None:
        """The trials of a configuration that were timed by themselves; None: not any."""
        return next((job.timing for job in self.jobs[name] if job.timing is not None), None)


def group_jobs(jobs: Sequence[Job]) -> list[Group]:
    """Split jobs into groups: the thesis's experiment first, its grids last."""
    by_rule: dict[tuple[str, int, float, int, str, str], list[Job]] = {}
    for job in jobs:
        o = job.outcomes
        rule = (o.experiment, o.cap, o.threshold, o.window, _environment(o), o.judged_by)
        by_rule.setdefault(rule, []).append(job)
    order = sorted(by_rule, key=lambda rule: (_rank(rule[0]), *map(str, rule)))
    ids = [_id(rule[0]) for rule in order]
    groups = [
        _group(f"{name}-{k}" if ids.count(name) > 1 else name, by_rule[rule])
        for k, (name, rule) in enumerate(zip(ids, order, strict=True), start=1)
    ]
    tells: list[Callable[[Group], str]] = [
        lambda g: g.environment,
        lambda g: f"cap {g.cap:,}",
        lambda g: g.configurations[0].judged_by,
    ]
    for tell in tells:
        titles = [g.title for g in groups]
        groups = [
            replace(g, title=f"{g.title}, {tell(g)}") if titles.count(g.title) > 1 else g
            for g in groups
        ]
    return groups


def _id(experiment: str) -> str:
    """The name of an experiment as part of a file's name: no path, and of letters that all have."""
    kept = (ch if (ch.isascii() and ch.isalnum()) or ch in "-_" else "-" for ch in experiment)
    return "".join(kept)[:60] or "experiment"


def _rank(experiment: str) -> int:
    return ORDER.index(experiment if experiment in ORDER else "")


def _environment(o: Outcomes) -> str:
    env = o.config.get("env")
    return str(env.get("id", "unknown")) if isinstance(env, dict) else "unknown"


def _group(name: str, jobs: list[Job]) -> Group:
    members: dict[str, list[Outcomes]] = {}
    for outcomes in deduplicate([job.outcomes for job in jobs]):
        members.setdefault(configuration_key(outcomes), []).append(outcomes)
    pooled = [pool(same) for same in members.values()]
    used: dict[str, int] = {}
    for k, c in enumerate(pooled):
        used[c.name] = used.get(c.name, 0) + 1
        if used[c.name] > 1:
            pooled[k] = replace(c, name=f"{c.name} ({used[c.name]})")
    by_name = {
        c.name: [j for j in jobs if configuration_key(j.outcomes) == key]
        for c, key in zip(pooled, members, strict=True)
    }
    ordered = natural_order(pooled)
    first = ordered[0]
    layout = crossed(ordered)
    if layout is None:
        looks = dict(zip((c.name for c in ordered), styles([c.strategy for c in ordered]),
                         strict=True))  # fmt: skip
    else:
        options = option_styles(len(layout.options))
        looks = {name: options[option] for (_, option), name in layout.cells.items()}
    return Group(
        id=name,
        title=_title(first.experiment, ordered),
        experiment=first.experiment,
        cap=first.cap,
        threshold=first.threshold,
        window=first.window,
        environment=_environment(first),
        configurations=ordered,
        labels=configuration_labels(ordered),
        styles=looks,
        jobs=by_name,
        parameter=swept_parameter(ordered),
        crossed=layout,
        plane=plane(ordered),
    )


def _title(experiment: str, configurations: Sequence[Outcomes]) -> str:
    strategies = list(dict.fromkeys(c.strategy for c in configurations))
    if experiment == "thesis" and len(strategies) != 5:
        return "The thesis's experiment, in part"
    if experiment in EXPERIMENTS:
        return EXPERIMENTS[experiment]
    named = ", ".join(map(strategy_label, strategies[:4])) + (", …" if len(strategies) > 4 else "")
    swept = " and ".join(map(symbol, swept_parameters(configurations)))
    what = f"{named}: values of {swept}" if swept else named
    return what if experiment == "train" else f"{experiment}: {what}"
