"""The claims of a study file, in the algebra of verdicts of ``thesis.rules``.

A claim has a ``statement`` and one rule: a key of ``RULES``, ``all`` or ``any`` with a list of
rules, or ``not`` with one. ``{thesis: ID}`` is a statement of the thesis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from trl_explore.report.selecting import fits, selector_words
from trl_explore.report.study import RULES, Selector
from trl_explore.report.tables import some
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import configuration_key, deduplicate, pool
from trl_explore.thesis import CLAIMS, Claim, Finding, NotMeasuredError, Study, rules


def own_claims(entries: Sequence[Mapping[str, Any]], place: str) -> list[Claim]:
    """The claims of a file; ``place`` is where they are made."""
    found = []
    for k, entry in enumerate(entries):
        if "thesis" in entry:
            found += [claim for claim in CLAIMS if claim.id == entry["thesis"]]
            continue
        (name,) = (key for key in entry if key in (*RULES, "all", "any", "not"))
        definition = str(entry.get("definition") or _definition(name, entry[name]))
        found.append(
            Claim(
                id=f"study.{k + 1}",
                statement=str(entry["statement"]),
                place=str(entry.get("place", place)),
                definition=definition,
                decide=partial(_decide, name, entry[name]),
            )
        )
    return found


def _decide(name: str, value: Any, study: Study) -> Finding:
    return _rule(name, value, study)(study.level)


def _rule(name: str, value: Any, study: Study) -> rules.Rule:
    """The rule of one entry; NotMeasuredError if a configuration is missing."""
    if name in ("all", "any"):
        parts = [_rule(key, part[key], study) for part in value for key in part]
        return rules.any_of(parts) if name == "any" else lambda level: rules.all_of(parts, level)
    if name == "not":
        ((key, part),) = value.items()
        return rules.contrary(_rule(key, part, study))
    unit = value.get("measure", "iterations")
    unit = 0.0 if unit == "frames" else unit
    if name in ("less", "ratio"):
        first, second = (
            study.sample(_find(study, value[key]), unit, selector_words(value[key]))
            for key in ("first", "second")
        )
        if name == "less":
            return rules.mean_less(first, second)
        what = f"{first.label} to {second.label}: ratio of the means"
        return rules.mean_ratio(first, second, value["low"], value["high"], what)
    o, what = _find(study, value["of"]), selector_words(value["of"])
    if name == "mean":
        sample = study.sample(o, unit, what)
        return rules.mean_within(sample, value["low"], value["high"], f"{what}: mean")
    done = f"{what} trials {'learned' if study.measure == 'learned' else 'pass'}"
    if name == "passes":
        return rules.passing(o, done, **{k: v for k, v in value.items() if k != "of"})
    passed = int(o.converged.sum())
    if name == "never_passes":
        return rules.never(passed, len(o), done)
    return rules.never(len(o) - passed, len(o), f"{what} trials fail")


def _find(study: Study, selector: Selector) -> Outcomes:
    found: dict[str, list[Outcomes]] = {}
    for o in study.outcomes:
        if fits(o, selector):
            found.setdefault(configuration_key(o), []).append(o)
    if len(found) != 1:
        names = some([jobs[0].name for jobs in found.values()]) if found else "none"
        fitting = f"{selector_words(selector)} fits {len(found)} configurations ({names})"
        raise NotMeasuredError(f"{fitting}; it must fit one")
    try:
        return pool(deduplicate(next(iter(found.values()))))
    except ValueError as error:
        raise NotMeasuredError(str(error)) from None


def _definition(name: str, value: Any) -> str:
    if name in ("all", "any"):
        parts = (_definition(key, part[key]) for part in value for key in part)
        return f"{name.capitalize()} of: {'; '.join(parts)}"
    if name == "not":
        return f"Not: {'; '.join(_definition(k, v) for k, v in value.items())}"
    unit = value.get("measure", "iterations")
    if name == "less":
        first, second = (selector_words(value[key]) for key in ("first", "second"))
        return f"Mean {unit}: {first} below {second}."
    bounds = [f"{word} {value[word]:g}" for word in ("above", "below", "low", "high")
              if word in value]  # fmt: skip
    whom = " and ".join(selector_words(value[k]) for k in ("of", "first", "second") if k in value)
    what = {"passes": "Share of trials that pass", "never_passes": "Fewer than 1 % pass",
            "always_passes": "More than 99 % pass", "ratio": f"Ratio of the mean {unit}",
            "mean": f"Mean {unit}"}[name]  # fmt: skip
    return f"{what} ({whom}){': ' if bounds else ''}{', '.join(bounds)}."
