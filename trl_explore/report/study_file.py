"""A study: a YAML file that says which question is asked of which configurations.

::

    title: Does a correction help ε-greedy?
    question: How fast do strategies learn, with and without the per-step ratio?
    configurations:                  # folders, globs, or overrides of a sweep that is run if needed
      - outputs/train
      - sweep: [strategy=softmax,epsilon_greedy, "correction=none,per_step", trials=50]
    compare:
      - effect_of: strategy          # or several that change together: [strategy, learning rate]
        at_each: correction
      - [softmax, {strategy: epsilon_greedy, epsilon: 0.3}]
    measures: [passed, score]        # of passed, score, learned
    claims:
      - statement: Softmax passes almost always.
        passes: {of: softmax, above: 0.8}
    level: 0.95
    leave_out: ["*pilot*", {trials: 5}]
    until: settled                   # add trials to the sweeps until their comparisons are decided
    budget: 500                      # most trials of a configuration then

Every key may be left out; ``configurations`` only if folders are given with the file.
``claims: thesis`` means the statements of the thesis. Without a file, the program infers the
questions from what differs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from trl_explore import thesis
from trl_explore.jobs.files import ResultsError
from trl_explore.statistics.estimates import LEVEL
from trl_explore.thesis import CLAIMS
from trl_explore.thesis.algebra import RULES

THESIS = Path(thesis.__file__).with_name("thesis.yaml")
"""The study of the thesis."""
KEYS = ("title", "question", "configurations", "compare", "measures", "claims", "level",
        "leave_out", "until", "budget")  # fmt: skip
MEASURES = ("passed", "score", "learned")
BUDGET, FEWEST = 500, 20
"""Most trials of a configuration that runs until it is settled, and the least that can be given."""
ALL_RULES = (*RULES, "all", "any", "not")
UNITS = ("iterations", "score", "frames")

Selector = str | Mapping[str, Any]
"""A label, name or strategy, or settings: ``{strategy: softmax, correction: per_step}``."""


@dataclass(frozen=True)
class Effect:
    """The effect of some factors, at each level of others."""

    of: tuple[str, ...]
    at: tuple[str, ...]


@dataclass(frozen=True)
class StudyFile:
    """What a study asks; the defaults ask what the jobs allow.

    ``sweeps`` are overrides of sweeps to run, ``claims`` is ``thesis`` or the study's own,
    ``leave_out`` has patterns of folders and selectors; ``budget`` is the most trials of a
    configuration of a sweep that runs until it is settled, None if the sweeps say how many;
    ``path`` is None without a file.
    """

    title: str = ""
    question: str = ""
    folders: tuple[Path, ...] = ()
    sweeps: tuple[tuple[str, ...], ...] = ()
    compare: tuple[Effect | tuple[Selector, Selector], ...] = ()
    measures: tuple[str, ...] = MEASURES
    claims: str | tuple[Mapping[str, Any], ...] = "thesis"
    level: float = LEVEL
    leave_out: tuple[Selector, ...] = ()
    budget: int | None = None
    path: Path | None = None


class _WrongError(Exception):
    """A value that is not allowed: key, value, and what is."""


def read_study(path: Path) -> StudyFile:
    """Read and check a study.

    Raises:
        ResultsError: the file cannot be read, or a value is not allowed; one line with key and
            value, and what is allowed.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = error.strerror if isinstance(error, OSError) else " ".join(str(error).split())
        raise ResultsError(f"{path}: not readable as YAML: {reason}") from None
    if not isinstance(content, Mapping):
        raise ResultsError(f"{path}: a study has the keys {', '.join(KEYS)}")
    try:
        return _checked(path, content)
    except _WrongError as wrong:
        key, value, allowed = wrong.args
        raise ResultsError(f"{path}: {key}={value!r}: {allowed}") from None


def _checked(path: Path, content: Mapping[str, Any]) -> StudyFile:
    lists = {key: [] if content.get(key) is None else _items(key, content[key])
             for key in ("compare", "leave_out", "configurations")}  # fmt: skip
    measures = _items("measures", content.get("measures", list(MEASURES)))
    claims = content.get("claims", ())
    if claims != "thesis":
        claims = tuple(_items("claims", claims))
    _check_values(content, measures)
    folders, sweeps = _configurations(path.parent, lists["configurations"])
    if "until" in content and not sweeps:
        raise _WrongError("until", content["until"], "a sweep among the configurations is needed")
    for k, claim in enumerate(claims if claims != "thesis" else ()):
        _check_claim(f"claims[{k}]", claim)
    for item in lists["leave_out"]:
        _check_selector("leave_out", item)
    return StudyFile(
        title=content.get("title", ""),
        question=content.get("question", ""),
        folders=folders,
        sweeps=sweeps,
        compare=tuple(_comparison(f"compare[{k}]", c) for k, c in enumerate(lists["compare"])),
        measures=tuple(measures),
        claims=claims,
        level=float(content.get("level", LEVEL)),
        leave_out=tuple(lists["leave_out"]),
        budget=content.get("budget", BUDGET) if "until" in content else None,
        path=path,
    )


def _check_values(content: Mapping[str, Any], measures: Sequence[Any]) -> None:
    """Check the names of the keys, and the keys with simple values."""
    for key, value in content.items():
        if key not in KEYS:
            raise _WrongError(key, value, f"the keys are {', '.join(KEYS)}")
        right, allowed = VALUES.get(key, (None, ""))
        if right and not right(value):
            raise _WrongError(key, value, allowed)
    for measure in measures:
        if measure not in MEASURES:
            raise _WrongError("measures", measure, f"{', '.join(MEASURES)} are possible")
    if "budget" in content and "until" not in content:
        raise _WrongError("budget", content["budget"], "until: settled is needed")


def _number(value: Any, kind: type = float) -> bool:
    return isinstance(value, int | kind) and not isinstance(value, bool)


VALUES: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    "title": (lambda v: isinstance(v, str), "a text is possible"),
    "question": (lambda v: isinstance(v, str), "a text is possible"),
    "level": (lambda v: _number(v) and 0.5 <= v < 1,
              "a number from 0.5 to below 1 is possible, such as 0.95"),
    "until": (lambda v: v == "settled", "settled is possible"),
    "budget": (lambda v: _number(v, int) and v >= FEWEST, f"an integer from {FEWEST} is possible"),
}  # fmt: skip
"""Key -> whether a value is right, and what is allowed."""


def _configurations(
    home: Path, items: Sequence[Any]
) -> tuple[tuple[Path, ...], tuple[tuple[str, ...], ...]]:
    """The folders, and the overrides of the sweeps; ``home`` is the folder of the file."""
    folders: list[Path] = []
    sweeps: list[tuple[str, ...]] = []
    for item in items:
        if isinstance(item, Mapping) and set(item) == {"sweep"}:
            words = item["sweep"]
            if not isinstance(words, list) or not all(isinstance(w, str) for w in words):
                raise _WrongError("sweep", words, "a list of overrides is possible: [strategy=a,b]")
            sweeps.append(tuple(words))
        elif isinstance(item, str):
            whole = (home / Path(item).expanduser()).absolute()
            found = Path(whole.anchor).glob(str(whole)[len(whole.anchor) :])
            found = [whole] if whole.is_dir() else sorted(f for f in found if f.is_dir())
            if not found:
                raise _WrongError("configurations", item, "no such folder")
            folders += found
        else:
            allowed = "a folder, a glob or {sweep: [...]} is possible"
            raise _WrongError("configurations", item, allowed)
    return tuple(dict.fromkeys(folders)), tuple(sweeps)


def _comparison(where: str, item: Any) -> Effect | tuple[Selector, Selector]:
    if isinstance(item, Mapping) and "effect_of" in item and set(item) <= {"effect_of", "at_each"}:
        of, at = (_items(where, item.get(k, ())) for k in ("effect_of", "at_each"))
        if of and all(isinstance(word, str) for word in (*of, *at)):
            return Effect(tuple(of), tuple(at))
    if isinstance(item, list) and len(item) == 2:
        for selector in item:
            _check_selector(where, selector)
        return item[0], item[1]
    allowed = "{effect_of: FACTOR, at_each: FACTOR} or a pair [first, second] is possible"
    raise _WrongError(where, item, allowed)


def _check_claim(where: str, claim: Any) -> None:
    if isinstance(claim, Mapping) and set(claim) == {"thesis"}:
        if claim["thesis"] not in (ids := [c.id for c in CLAIMS]):
            raise _WrongError(where, claim["thesis"], f"statements of the thesis: {', '.join(ids)}")
        return
    if not isinstance(claim, Mapping) or not isinstance(claim.get("statement"), str):
        raise _WrongError(where, claim, "a claim has a statement and one rule")
    rest = {k: v for k, v in claim.items() if k not in ("statement", "place", "definition")}
    if len(rest) != 1:
        raise _WrongError(where, list(rest), f"one rule is needed: {', '.join(ALL_RULES)}")
    _check_rules(where, rest)


def _check_rules(where: str, entry: Any) -> None:
    """Check every rule of a mapping from rules to their values."""
    if not isinstance(entry, Mapping) or not entry:
        raise _WrongError(where, entry, f"rules are {', '.join(ALL_RULES)}")
    for name, value in entry.items():
        place = f"{where}.{name}"
        if name in ("all", "any"):
            for part in _items(place, value):
                _check_rules(place, part)
        elif name == "not":
            _check_rules(place, value)
        elif name not in RULES:
            raise _WrongError(where, name, f"rules are {', '.join(ALL_RULES)}")
        else:
            _check_rule(place, name, value)


def _check_rule(where: str, name: str, value: Any) -> None:
    needed, optional = RULES[name]
    known = needed + optional
    if not isinstance(value, Mapping):
        raise _WrongError(where, value, f"a mapping with {', '.join(known)} is possible")
    if name == "passes" and len({"above", "below"} & set(value)) != 1:
        raise _WrongError(where, dict(value), "above or below is needed")
    for key in (*needed, *value):
        if key not in value or key not in known:
            raise _WrongError(f"{where}.{key}", value.get(key), f"keys: {', '.join(known)}")
        if key in ("of", "first", "second"):
            _check_selector(f"{where}.{key}", value[key])
            continue
        right, allowed = _number(value[key]), "a number is possible"
        if key == "measure":
            right, allowed = value[key] in UNITS, f"{', '.join(UNITS)} are possible"
        elif right and key in ("above", "below"):
            right, allowed = 0 < value[key] < 1, "a share between 0 and 1 is possible"
        elif right and key == "high":
            right, allowed = value["low"] < value[key], f"more than low={value['low']} is possible"
        if not right:
            raise _WrongError(f"{where}.{key}", value[key], allowed)


def _check_selector(where: str, value: Any) -> None:
    if not isinstance(value, str) and not (isinstance(value, Mapping) and value):
        raise _WrongError(where, value, "a name or a mapping of settings is possible")


def _items(key: str, value: Any) -> list[Any]:
    if isinstance(value, str):
        return [value]
    if not isinstance(value, list | tuple):
        raise _WrongError(key, value, "a list is possible")
    return list(value)
