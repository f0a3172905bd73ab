"""Which configurations a study means, the questions that it asks of them, and its claims.

Claims are decided in the ``thesis.algebra``. A claim has a ``statement`` and
one rule: a key of ``RULES``, ``all`` or ``any`` with a list of rules, or ``not`` with one.
``{thesis: ID}`` is a statement of the thesis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from typing import Any

from trl_explore.jobs.files import ResultsError
from trl_explore.names import strategy_label
from trl_explore.report.factors import Factor, arguments, canonical, class_words
from trl_explore.report.groups import Group
from trl_explore.report.loading import Job
from trl_explore.report.questions import Block, Question, ask, differing
from trl_explore.report.study_file import MEASURES, Effect, Selector, StudyFile
from trl_explore.report.table_formats import some
from trl_explore.statistics.outcomes import Outcomes, judged
from trl_explore.statistics.pairing import AGENT_GROUPS, configuration_key, deduplicate, pool
from trl_explore.thesis import CLAIMS, Claim, NotMeasuredError, Study
from trl_explore.thesis.algebra import RULES, decision

ENVIRONMENT = ("env", "environment")
"""What a study calls the environment, which is no factor: environments are never compared."""


def without(jobs: Sequence[Job], study: StudyFile) -> list[Job]:
    """The jobs that the study does not leave out.

    Raises:
        ResultsError: an entry of ``leave_out`` fits no job, or nothing is left.
    """
    kept = list(jobs)
    for item in study.leave_out:
        pattern = item if isinstance(item, str) else None
        out = {
            job.folder
            for job in jobs
            if fits(job.outcomes, item)
            or (pattern and any(fnmatch(text, pattern) for text in _paths(job)))
        }
        if not out:
            raise ResultsError(f"{study.path}: leave_out: {item!r} fits no job")
        kept = [job for job in kept if job.folder not in out]
    if not kept:
        raise ResultsError(f"{study.path}: leave_out: no job is left")
    return kept


def asked(groups: Sequence[Group], study: StudyFile) -> list[Group]:
    """The groups with the questions of the study instead of the inferred ones.

    Raises:
        ResultsError: a factor does not vary, or a selector does not fit one configuration.
    """
    if "learned" not in study.measures:
        groups = [replace(g, learned=()) for g in groups]
    elif study.measures != MEASURES:
        only = not {"passed", "score"} & set(study.measures)
        groups = [_by_learning(g, only) for g in groups]
    if not study.compare:
        return list(groups)
    found: dict[str, list[Question]] = {g.id: [] for g in groups}
    places = ENVIRONMENT if len({g.environment for g in groups}) > 1 else ()
    for k, item in enumerate(study.compare):
        where = f"{study.path}: compare[{k}]"
        answers = {g.id: _question(g, item, places) for g in groups}
        if not any(answers.values()):
            raise ResultsError(f"{where}: {_reason(groups, item)}")
        for name, question in answers.items():
            found[name] += [question] if question is not None else []
    return [replace(g, questions=found[g.id], chosen=True) for g in groups if found[g.id]]


def _by_learning(group: Group, only: bool) -> Group:
    """The group judged by what was learned, or with a note that this is unknown."""
    if group.learned:
        learned = list(group.learned)
        return replace(group, configurations=learned, learned=()) if only else group
    reasons = []
    for c in group.configurations:
        try:
            judged(c, "learned")
        except ValueError as error:
            reasons.append(str(error))
    used = "; the results are those of passing" if only else ""
    note = f"What was learned is unknown ({reasons[0]}){used}."
    return replace(group, notes=(*group.notes, note))


def fits(c: Outcomes, selector: Selector) -> bool:
    """Whether a configuration is meant."""
    if isinstance(selector, str):
        name = _plain(selector)
        return name in (_plain(c.name), _plain(c.strategy), _plain(class_words("strategy",
                        {"_target_": c.strategy})))  # fmt: skip
    return all(_has(c, str(key), value) for key, value in selector.items())


def _question(
    group: Group, item: Effect | tuple[Selector, Selector], places: Sequence[str]
) -> Question | None:
    names = [c.name for c in group.configurations]
    if isinstance(item, Effect):
        of = [_factor(group.factors, word) for word in item.of]
        # Every environment is a group of its own.
        at = [_factor(group.factors, word) for word in item.at if word not in places]
        if None in of or None in at:
            return None
        return ask(names, group.factors, [f for f in of if f is not None])
    chosen = [[c.name for c in group.configurations if _means(c, group, s)] for s in item]
    if any(len(found) != 1 for found in chosen) or chosen[0] == chosen[1]:
        return None
    pair = chosen[0][0], chosen[1][0]
    factors = differing(group.factors, pair)
    held = [f.words[pair[0]] for f in group.factors if f not in factors]
    return Question(tuple(factors), (Block(", ".join(w for w in held if w), pair),))


def _means(c: Outcomes, group: Group, selector: Selector) -> bool:
    if isinstance(selector, str) and _plain(group.labels[c.name]) == _plain(selector):
        return True
    return fits(c, selector)


def _factor(factors: Sequence[Factor], word: str) -> Factor | None:
    return next((f for f in factors if f.has(word)), None)


def _reason(groups: Sequence[Group], item: Effect | tuple[Selector, Selector]) -> str:
    """Why no group can answer."""
    varied = list(dict.fromkeys(f.label for g in groups for f in g.factors))
    if isinstance(item, Effect):
        for word in (*item.of, *item.at):
            if word in ENVIRONMENT or not any(_factor(g.factors, word) for g in groups):
                return (
                    f"{word!r} does not vary among configurations with the same environment and"
                    f" stopping rule; what varies: {', '.join(varied) or 'nothing'}"
                )
        return f"no two configurations differ only in {' and '.join(item.of)}"
    texts = []
    for selector in item:
        found = [g.labels[c.name] for g in groups for c in g.configurations
                 if _means(c, g, selector)]  # fmt: skip
        if len(found) != 1:
            texts.append(f"{selector_words(selector)!r} fits {len(found)} configurations"
                         f"{f' ({some(found)})' if found else ''}")  # fmt: skip
    known = [g.labels[c.name] for g in groups for c in g.configurations]
    if not texts and len({c.name for g in groups for c in g.configurations
                          if any(_means(c, g, s) for s in item)}) == 1:  # fmt: skip
        return "both are the same configuration"
    if not texts:
        return "the two have different environments or stopping rules"
    return f"{'; '.join(texts)}; each must fit one of: {some(known)}"


def _has(c: Outcomes, key: str, value: Any) -> bool:
    """Whether a configuration has a setting."""
    if key in ("trials", "cap"):
        return (len(c) if key == "trials" else c.cap) == value
    groups = ("strategy", *AGENT_GROUPS)
    if key in groups:
        flat = arguments(c, key)
        names = {_plain(str(flat.get("_target_", "")).rsplit(".", 1)[-1]), _plain(flat.get("id")),
                 _plain(class_words(key, flat)), _plain(flat.get(""))}  # fmt: skip
        word = "no correction" if (key, value) == ("correction", "none") else value
        return _plain(word) in names or canonical(flat.get("")) == canonical(value)
    for group in groups:
        for name, found in arguments(c, group).items():
            full = f"{group}.{name}"
            if key in (full, name) and canonical(found) == canonical(value):
                return True
    return False


def _plain(text: Any) -> str:
    """A name without case, spaces and hyphens: ``per_step`` and ``PerStep`` are the same."""
    return str(text).lower().replace("_", "").replace(" ", "").replace("-", "")


def selector_words(selector: Selector) -> str:
    """A selector for readers."""
    if isinstance(selector, str):
        return selector
    said = {"strategy": strategy_label, "policy": str, "baseline": str,
            "correction": lambda v: "uncorrected" if v == "none" else str(v)}  # fmt: skip
    return ", ".join(
        said[key](str(value)) if key in said else f"{key} = {value}"
        for key, value in selector.items()
    )


def _paths(job: Job) -> tuple[str, ...]:
    return job.folder.name, f"{job.folder.parent.name}/{job.folder.name}", str(job.folder)


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
                decide=decision({name: entry[name]}, _find),
            )
        )
    return found


def _find(study: Study, selector: Selector) -> dict[str, Outcomes]:
    """Label -> the one configuration that a selector fits."""
    found: dict[str, list[Outcomes]] = {}
    for o in study.outcomes:
        if fits(o, selector):
            found.setdefault(configuration_key(o), []).append(o)
    if len(found) != 1:
        names = some([jobs[0].name for jobs in found.values()]) if found else "none"
        fitting = f"{selector_words(selector)} fits {len(found)} configurations ({names})"
        raise NotMeasuredError(f"{fitting}; it must fit one")
    try:
        return {selector_words(selector): pool(deduplicate(next(iter(found.values()))))}
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
            "mean": f"Mean {unit}",
            "faster": "The first converges earlier in most trials"}[name]  # fmt: skip
    return f"{what} ({whom}){': ' if bounds else ''}{', '.join(bounds)}."
