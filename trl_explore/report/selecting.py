"""Which configurations a study means, and the questions that it asks of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatch
from typing import Any

from trl_explore.jobs.columns import ResultsError
from trl_explore.report.factors import Factor, arguments, canonical, class_words
from trl_explore.report.groups import Group
from trl_explore.report.loading import Job
from trl_explore.report.questions import Block, Question, ask, differing
from trl_explore.report.study import Effect, Selector, StudyFile
from trl_explore.report.tables import some
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import AGENT_GROUPS


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
    elif not {"passed", "score"} & set(study.measures):
        groups = [
            replace(g, configurations=list(g.learned), learned=()) if g.learned else g
            for g in groups
        ]
    if not study.compare:
        return list(groups)
    found: dict[str, list[Question]] = {g.id: [] for g in groups}
    for k, item in enumerate(study.compare):
        where = f"{study.path}: compare[{k}]"
        answers = {g.id: _question(g, item) for g in groups}
        if not any(answers.values()):
            raise ResultsError(f"{where}: {_reason(groups, item)}")
        for name, question in answers.items():
            found[name] += [question] if question is not None else []
    return [replace(g, questions=found[g.id], chosen=True) for g in groups if found[g.id]]


def fits(c: Outcomes, selector: Selector) -> bool:
    """Whether a configuration is meant."""
    if isinstance(selector, str):
        name = _plain(selector)
        return name in (_plain(c.name), _plain(c.strategy), _plain(class_words("strategy",
                        {"_target_": c.strategy})))  # fmt: skip
    return all(_has(c, str(key), value) for key, value in selector.items())


def _question(group: Group, item: Effect | tuple[Selector, Selector]) -> Question | None:
    names = [c.name for c in group.configurations]
    if isinstance(item, Effect):
        of = [_factor(group.factors, word) for word in item.of]
        at = [_factor(group.factors, word) for word in item.at]
        if None in of or None in at:
            return None
        return ask(names, group.factors, [f for f in of if f is not None])
    chosen = [[c.name for c in group.configurations if _means(c, group, s)] for s in item]
    if any(len(found) != 1 for found in chosen) or chosen[0] == chosen[1]:
        return None
    pair = chosen[0][0], chosen[1][0]
    return Question(tuple(differing(group.factors, pair)), (Block("", pair),))


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
            if word in ("env", "environment") or not any(_factor(g.factors, word) for g in groups):
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
    return ", ".join(f"{value}" if key in ("strategy", "policy", "correction", "baseline")
                     else f"{key} = {value}" for key, value in selector.items())  # fmt: skip


def _paths(job: Job) -> tuple[str, ...]:
    return job.folder.name, f"{job.folder.parent.name}/{job.folder.name}", str(job.folder)
