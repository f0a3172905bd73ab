"""The rules of claims by name: what ``claims.yaml`` and the study files of users may say.

An entry has one rule and its values, ``{passes: {of: softmax, above: 0.8}}``. Entries combine:

    all: [...], any: [...]                     all or at least one of the entries
    not: {...}                                 the negation of an entry
    under: {correction: NAME, ...}             an entry, asked of the experiments with corrections

``of``, ``first`` and ``second`` select configurations: those of the thesis as :func:`find` says; a
rule holds if it holds for each.
``measure`` is ``iterations`` (restricted to the cap), ``score``, ``frames`` or ``time``, ``among``
is ``passing`` or ``failing`` trials.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from trl_explore.names import option_label, strategy_label, symbol
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.samples import Sample
from trl_explore.thesis import rules, single_claims
from trl_explore.thesis.rules import Decision, Finding, Rule
from trl_explore.thesis.single_claims import Find
from trl_explore.thesis.study import NotMeasuredError, Study

Entry = Mapping[str, Any]
Finder = Callable[[Study, Any], Mapping[str, Outcomes]]
"""Study and selector -> label for readers -> configuration."""

RULES: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "passes": (("of",), ("above", "below")),
    "never_passes": (("of",), ()),
    "always_passes": (("of",), ()),
    "less": (("first", "second"), ("measure",)),
    "ratio": (("first", "second", "low", "high"), ("measure",)),
    "mean": (("of", "low", "high"), ("measure",)),
    "faster": (("first", "second"), ()),
}
"""Rule of a study file -> the keys that it needs, and those that it may have."""


def find(study: Study, selector: Any) -> dict[str, Outcomes]:
    """Label for readers -> configuration, under the conditions of the thesis.

    Args:
        study: the data.
        selector: a strategy or several of the thesis's experiment, or all others, ``{but:
            softmax}``; a value of a grid, ``{grid: decay, value: 0.99}``, all others, ``{grid:
            decay, but: 0.99}``, those above the median, ``{grid: decay, above: median}``, or all;
            a strategy with some or ``all`` corrections, ``{strategy: argmax, corrections: all}``.

    Raises:
        NotMeasuredError: one of them was not run.
    """
    if isinstance(selector, Mapping) and "grid" in selector:
        return _of_grid(study, **selector)
    if isinstance(selector, Mapping) and "corrections" in selector:
        name, called = selector["strategy"], strategy_label(selector["strategy"])
        found = study.corrected(name, selector["corrections"])
        return {f"{called}, {option_label('correction', k)}": o for k, o in found.items()}
    if isinstance(selector, Mapping):
        names = [name for name in study.strategies if name != selector["but"]]
    else:
        names = [selector] if isinstance(selector, str) else selector
    return {strategy_label(name): study.strategy(name) for name in names}


def _of_grid(
    study: Study,
    grid: str,
    value: float | None = None,
    but: float | None = None,
    above: str = "",
    needs: float | None = None,
) -> dict[str, Outcomes]:
    found, called = study.grid(f"{grid}_grid", grid), symbol(grid)
    for chosen in (value, but, needs):
        if chosen is not None and (chosen not in found or len(found) < 2):
            raise NotMeasuredError(
                f"the grid of {called} needs {chosen:g} and at least one other value"
            )
    least = float(np.median(list(found))) if above else -np.inf
    how = f", {option_label('correction', study.correction)}" if study.correction else ""
    chosen = {
        f"{called} = {x:g}{how}": o
        for x, o in found.items()
        if value in (None, x) and x != but and x > least
    }
    if not chosen:  # a rule over nothing would hold
        raise NotMeasuredError(f"no value of the grid of {called} is above the median")
    return chosen


def _trials_of(label: str) -> str:
    """The trials of a configuration.

    >>> _trials_of("argmax, uncorrected"), _trials_of("T = 1.5, per-step ratio")
    ('argmax trials (uncorrected)', 'trials with T = 1.5 (per-step ratio)')
    """
    name, _, how = label.partition(", ")
    trials = f"trials with {name}" if " = " in name else f"{name} trials"
    return f"{trials} ({how})" if how else trials


def decision(entry: Entry, find: Finder = find) -> Decision:
    """The function that decides an entry; it may raise NotMeasuredError."""

    def decide(study: Study, unit: Any = None) -> Finding:
        ((name, value),) = entry.items()
        timed = {name: {**value, "measure": unit}} if unit is not None else entry
        return rules.all_of(parts(timed, study, find), study.level)

    (value,) = entry.values()
    timed = isinstance(value, Mapping) and value.get("measure") == "time"
    return rules.in_time(decide) if timed else decide


def parts(entry: Entry, study: Study, find: Finder) -> Sequence[Rule]:
    """The rules that must all hold for an entry to hold."""
    ((name, value),) = entry.items()
    if name == "all":
        return [rule for part in value for rule in parts(part, study, find)]
    if name in ("any", "not"):
        found = [_joined(parts({k: v}, study, find))
                 for part in (value if name == "any" else [value])
                 for k, v in part.items()]  # fmt: skip
        return [rules.any_of(found)] if name == "any" else [rules.contrary(_joined(found))]
    if name == "under":
        rest = {key: part for key, part in value.items() if key != "correction"}
        return parts(rest, study.under(value["correction"]), find)
    return NAMED[name](study, partial(find, study), **value)


def _joined(found: Sequence[Rule]) -> Rule:
    return found[0] if len(found) == 1 else lambda level: rules.all_of(found, level)


def _passes(study: Study, find: Find, of: Any, **bound: float) -> list[Rule]:
    did = "learned" if study.measure == "learned" else "pass"
    return [
        rules.share(int(o.converged.sum()), len(o), f"{_trials_of(label)} {did}", **bound)
        for label, o in find(of).items()
    ]


def _always_passes(study: Study, find: Find, of: Any) -> list[Rule]:
    return [
        rules.never(int((~o.converged).sum()), len(o), f"{_trials_of(label)} fail")
        for label, o in find(of).items()
    ]


def _samples(
    study: Study, found: Mapping[str, Outcomes], measure: Any, among: str = ""
) -> list[Sample]:
    unit = 0.0 if measure == "frames" else measure
    whole = [study.sample(o, unit, label) for label, o in found.items()]
    if not among:
        return whole
    passing = among == "passing"
    word = among if study.measure != "learned" else "learning" if passing else "not learning"
    return [s.only(s.converged == passing, f"{word} {s.label}") for s in whole]


def _less(
    study: Study,
    find: Find,
    first: Any,
    second: Any,
    measure: Any = "iterations",
    among: str | Sequence[str] = "",
    at_least_one: bool = False,
) -> list[Rule]:
    """The mean of each first is less than that of each second, or that of at least one is."""
    kinds = (among, among) if isinstance(among, str) else among
    a, b = (
        _samples(study, find(selector), measure, kind)
        for selector, kind in zip((first, second), kinds, strict=True)
    )
    pairs = [(x, y) for x in a for y in b]
    # Without a pair that has trials, an empty one makes the rule open.
    known = [pair for pair in pairs if all(map(len, pair))] or pairs[:1]
    found = [rules.mean_less(x, y) for x, y in known]
    return [rules.any_of(found)] if at_least_one else found


def _ratio(
    study: Study,
    find: Find,
    first: Any,
    second: Any,
    low: float,
    high: float,
    measure: Any = "iterations",
) -> list[Rule]:
    (a,), (b,) = (_samples(study, find(s), measure) for s in (first, second))
    return [rules.mean_ratio(a, b, low, high, f"mean of {a.label} over mean of {b.label}")]


def _mean(
    study: Study, find: Find, of: Any, low: float, high: float, measure: str = "iterations"
) -> list[Rule]:
    kind = "learned" if study.measure == "learned" else "final"
    word = f"{kind} score" if measure == "score" else measure
    return [
        rules.mean_within(s, low, high, f"mean {word} of {s.label}")
        for s in _samples(study, find(of), measure)
    ]


def _quantiles(
    study: Study, find: Find, of: Any, weights: Mapping[float, float], what: str, measure: Any
) -> list[Rule]:
    return [
        rules.quantiles_above_zero(s, tuple(weights.items()), f"{s.label}: {what}")
        for s in _samples(study, find(of), measure)
    ]


NAMED: Mapping[str, Callable[..., Sequence[Rule]]] = {
    "passes": _passes,
    "never_passes": partial(_passes, below=rules.RARELY),
    "always_passes": _always_passes,
    "less": _less,
    "ratio": _ratio,
    "mean": _mean,
    "quantiles": _quantiles,
    "scores": single_claims.scores,
    "passes_early": single_claims.passes_early,
    "converge_late": single_claims.converge_late,
    "faster": single_claims.faster,
    "differ": single_claims.differ,
    "exploring_costs": single_claims.exploring_costs,
    "baseline": single_claims.baseline,
    "bias_explains": single_claims.bias_explains,
}
"""Rule -> its parts, from the study, a function that finds a selector, and the values."""
RULE_NAMES = (*NAMED, "all", "any", "not", "under")
