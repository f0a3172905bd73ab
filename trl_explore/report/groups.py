"""Groups of configurations that are compared, and their layouts.

A group is one experiment with one stopping rule. Its configurations may form a layout: rows crossed
with options, or a plane of two parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trl_explore.names import (
    EXPERIMENTS,
    experiment,
    experiment_rank,
    strategy_label,
    symbol,
)
from trl_explore.report.labels import (
    configuration_labels,
    label_parts,
    natural_order,
    swept_parameter,
    swept_parameters,
)
from trl_explore.report.layouts import SIZE, Crossed, Plane, crossed, plane
from trl_explore.report.loading import Job
from trl_explore.report.style import Style, option_styles, styles
from trl_explore.statistics.outcomes import Outcomes, judged
from trl_explore.statistics.pairing import configuration_key, deduplicate, pool, select


@dataclass(frozen=True, eq=False)
class Group:
    """Configurations that may be compared with each other.

    Attributes:
        id: unique, usable in file names.
        title: heading in the report.
        experiment: name of the experiment.
        cap: maximum number of iterations.
        threshold: score above which a trial passes.
        window: number of episodes that the final score averages over.
        environment: id of the environment.
        configurations: in the order of the figures; seeds pooled, each (seed, trial) once; judged
            by training scores if these decide, else as the jobs were stopped.
        learned: the same, judged by what was learned; empty if that is unknown.
        labels: name of a configuration -> label.
        styles: name of a configuration -> style.
        jobs: name of a configuration -> its jobs.
        parameter: label of the only parameter in which the configurations differ, or None.
        crossed: layout of rows crossed with options, or None.
        plane: layout of two parameters, or None.
        sized: whether the configurations differ in the size of the task.

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
    learned: Sequence[Outcomes] = ()
    sized: bool = False

    @property
    def is_grid(self) -> bool:
        """Whether the experiment is a grid over one parameter."""
        return experiment(self.experiment).grid

    def short(self, name: str) -> str:
        """The label of a configuration without the parameter's name, which the axis shows."""
        return self.labels[name].removeprefix(f"{self.parameter} = ")

    def timed(self, c: Outcomes) -> tuple[Outcomes, NDArray[np.float64]]:
        """The trials of a configuration that were timed alone, and their seconds [n]."""
        timing = next((job.timing for job in self.jobs[c.name] if job.timing is not None), None)
        first = {int(t): i for i, t in reversed(list(enumerate(c.trial)))}
        pairs = zip(timing.trial, timing.seconds, strict=True) if timing is not None else ()
        known = [(first[int(t)], s) for t, s in pairs if int(t) in first]
        index = np.array([i for i, _ in known], dtype=np.intp)
        return select(c, index), np.array([s for _, s in known])


def group_jobs(jobs: Sequence[Job]) -> list[Group]:
    """Split jobs into groups by experiment and stopping rule, in the order of the report."""
    by_rule: dict[tuple[str, int, float, int, str, str], list[Job]] = {}
    for job in jobs:
        o = job.outcomes
        rule = (o.experiment, o.cap, o.threshold, o.window, _environment(o), o.judged_by)
        by_rule.setdefault(rule, []).append(job)
    order = sorted(by_rule, key=lambda rule: (experiment_rank(rule[0]), *map(str, rule)))
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
    """The name of an experiment as a safe part of file names: ASCII, without path separators."""
    kept = (ch if (ch.isascii() and ch.isalnum()) or ch in "-_" else "-" for ch in experiment)
    return "".join(kept)[:60] or "experiment"


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
    learned = _judged(ordered, "learned")
    ordered = _judged(ordered, "passed") or ordered
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
        learned=learned,
        sized=any(SIZE in words for words in label_parts(ordered).values()),
    )


def _judged(configurations: Sequence[Outcomes], measure: str) -> list[Outcomes]:
    """The configurations by one measure; empty if it is unknown of one."""
    try:
        return [judged(c, measure) for c in configurations]
    except ValueError:
        return []


def _title(experiment: str, configurations: Sequence[Outcomes]) -> str:
    strategies = list(dict.fromkeys(c.strategy for c in configurations))
    if experiment == "thesis" and len(strategies) != 5:
        return "The thesis's experiment, in part"
    if experiment in EXPERIMENTS:
        return EXPERIMENTS[experiment].title
    named = ", ".join(map(strategy_label, strategies[:4])) + (", …" if len(strategies) > 4 else "")
    swept = " and ".join(map(symbol, swept_parameters(configurations)))
    what = f"{named}: values of {swept}" if swept else named
    return what if experiment == "train" else f"{experiment}: {what}"
