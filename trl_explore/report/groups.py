"""Groups of configurations that are compared, and their layouts.

A group is one experiment with one stopping rule. Its configurations may form a layout: rows crossed
with options, or a plane of two parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.names import EXPERIMENTS, experiment, experiment_rank, strategy_label, symbol
from trl_explore.report.factors import (
    Factor,
    arguments,
    canonical,
    configuration_labels,
    factors_of,
    natural_order,
    swept_parameter,
    swept_parameters,
    value_words,
)
from trl_explore.report.layouts import SIZE, Crossed, Plane, crossed, pairs_by_size, plane
from trl_explore.report.loading import Job, repeats, set_aside, settled
from trl_explore.report.questions import Confound, Question, confounds, inferred
from trl_explore.report.style import Style, option_styles, styles
from trl_explore.report.table_formats import listed
from trl_explore.statistics.outcomes import Outcomes, judged
from trl_explore.statistics.pairing import configuration_key, deduplicate, pool, select


@dataclass(frozen=True, eq=False)
class Group:
    """Configurations that may be compared with each other.

    Attributes:
        id: unique, usable in file names.
        cap, threshold, window: the stopping rule.
        environment: id of the environment, with what differs from others of the id.
        configurations: in the order of the figures; seeds pooled, each (seed, trial) once; judged
            by training scores if these decide, else as the jobs were stopped.
        labels, styles, jobs: by the name of a configuration.
        parameter: label of the only parameter in which the configurations differ, or None.
        crossed, plane: the layout, if there is one.
        learned: the configurations, judged by what was learned; empty if that is unknown.
        sized: whether the configurations differ in the size of the task.
        factors: the settings that are not the same for all of them.
        questions: the factors that are varied while all others are held.
        confounds: the factors that only change together.
        notes: what was done with pilots and repeats.
        chosen: whether a study file chose the questions.
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
    factors: Sequence[Factor] = ()
    questions: Sequence[Question] = ()
    confounds: Sequence[Confound] = ()
    notes: Sequence[str] = ()
    chosen: bool = False

    @property
    def env_id(self) -> str:
        """The id of the environment, without what differs from others of the id."""
        return str(arguments(self.configurations[0], "env").get("id", "unknown"))

    @property
    def did(self) -> str:
        """What the trials that converged did: ``passed``, or ``learned``."""
        return "learned" if self.configurations[0].measure == "learned" else "passed"

    @property
    def free(self) -> bool:
        """Whether the configurations differ in one factor, so that all of them are compared."""
        return len(self.factors) < 2

    @property
    def is_grid(self) -> bool:
        """Whether the experiment is a grid over one parameter."""
        return experiment(self.experiment).grid

    def pairs(self) -> list[tuple[Outcomes, Outcomes]]:
        """The planned pairs of a layout; otherwise those of the questions, or all."""
        if self.sized:
            return list(pairs_by_size(self.configurations))
        by_name = {c.name: c for c in self.configurations}
        layout = self.crossed or self.plane
        if layout is not None and not self.chosen:
            return [(by_name[a], by_name[b]) for a, b in layout.pairs()]
        if self.free and not self.chosen:
            return list(combinations(self.configurations, 2))
        asked = [pair for question in self.questions for pair in question.pairs]
        # Two questions may ask for the same pair, in either order.
        names = {frozenset(pair): pair for pair in reversed(asked)}
        return [(by_name[a], by_name[b]) for a, b in reversed(names.values())]

    def short(self, name: str) -> str:
        """The label of a configuration without the parameter's name, which the axis shows."""
        return self.labels[name].removeprefix(f"{self.parameter} = ")

    def timed(self, c: Outcomes) -> tuple[Outcomes, NDArray[np.float64]]:
        """The trials of a configuration that were timed alone, and their seconds [n]."""
        timing = next((job.timing for job in self.jobs[c.name] if job.timing is not None), None)
        first = c.first_index
        pairs = zip(timing.trial, timing.seconds, strict=True) if timing is not None else ()
        known = [(first[int(t)], s) for t, s in pairs if int(t) in first]
        index = np.array([i for i, _ in known], dtype=np.intp)
        return select(c, index), np.array([s for _, s in known])


def group_jobs(jobs: Sequence[Job], *, together: bool = False) -> list[Group]:
    """Split jobs into groups by experiment, environment and stopping rule, in the report's order.

    A pilot is left out: all its configurations are in another group, with a cap that is not lower
    and with more trials. The other group's notes say so.

    Args:
        jobs: finished jobs.
        together: whether jobs of different experiments are compared.
    """
    places = environment_labels([job.outcomes for job in jobs])
    by_rule: dict[tuple[Any, ...], list[Job]] = {}
    for job in jobs:
        o = job.outcomes
        experiment = "" if together else o.experiment
        rule = (experiment, o.cap, o.threshold, o.window, _environment(o), o.judged_by)
        by_rule.setdefault(rule, []).append(job)
    notes = set_aside(by_rule)
    order = sorted(by_rule, key=lambda rule: (experiment_rank(rule[0]), *map(str, rule)))
    ids = [_id(rule[0]) for rule in order]
    groups = [
        replace(
            _group(f"{name}-{k}" if ids.count(name) > 1 else name, by_rule[rule]),
            environment=places[rule[4]],
            notes=(*repeats(by_rule[rule]), *notes.get(rule, ()), *settled(by_rule[rule])),
        )
        for k, (name, rule) in enumerate(zip(ids, order, strict=True), start=1)
    ]
    tells: list[Callable[[Group], str]] = [
        lambda g: g.environment,
        lambda g: f"cap {g.cap:,}",
        lambda g: g.configurations[0].judged_by,
    ]
    for tell in tells:
        groups = [
            replace(g, title=f"{g.title}, {tell(g)}")
            if len({tell(h) for h in groups if h.title == g.title}) > 1
            else g
            for g in groups
        ]
    return groups


def environment_labels(outcomes: Sequence[Outcomes]) -> dict[str, str]:
    """Canonical text of an environment -> its name, with what differs from others of its id."""
    flats = {_environment(o): arguments(o, "env") for o in outcomes}
    found = {}
    for text, flat in flats.items():
        alike = [f for f in flats.values() if f.get("id") == flat.get("id")]
        words = [
            f"{symbol(f'env.{key}')} = {value_words(value)}"
            for key, value in flat.items()
            if key != SIZE.removeprefix("env.")
            and any(canonical(f.get(key)) != canonical(value) for f in alike)
        ]
        name = str(flat.get("id", "unknown"))
        found[text] = f"{name} ({', '.join(words)})" if words else name
    return found


def _id(experiment: str) -> str:
    """The name of an experiment as a safe part of file names: ASCII, without path separators."""
    kept = (ch if (ch.isascii() and ch.isalnum()) or ch in "-_" else "-" for ch in experiment)
    return "".join(kept)[:60] or "experiment"


def _environment(o: Outcomes) -> str:
    """Canonical text of the environment without the size of its task."""
    flat = arguments(o, "env")
    return canonical({k: v for k, v in flat.items() if f"env.{k}" != SIZE})


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
    factors, names = factors_of(ordered), [c.name for c in ordered]
    commands = {c.name: by_name[c.name][0].command for c in ordered}
    sized = any(f.key == SIZE for f in factors)
    flat = plane(ordered)
    layout = None if sized or flat is not None else crossed(ordered)
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
        environment="",
        configurations=ordered,
        labels=configuration_labels(ordered),
        styles=looks,
        jobs=by_name,
        parameter=swept_parameter(ordered),
        crossed=layout,
        plane=flat,
        learned=learned,
        sized=sized,
        factors=factors,
        questions=inferred(names, factors),
        confounds=[] if sized or flat else confounds(names, factors, commands),
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
    keys = swept_parameters(configurations)
    swept = listed([symbol(key) for key in keys]) if keys else ""
    what = f"{named}: values of {swept}" if swept else named
    others = [f.label for f in factors_of(configurations) if f.key != "strategy"]
    if others and not swept:
        what = f"{named}: {listed(['strategy', *others])}"
    return what if experiment == "train" else f"{experiment}: {what}"
