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

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from trl_explore import thesis
from trl_explore.jobs.columns import ResultsError
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
SELECTORS = "a name or a mapping of settings is possible"
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
    for key in content:
        if key not in KEYS:
            _refuse(path, str(key), content[key], f"the keys are {', '.join(KEYS)}")
    _check_values(path, content)
    folders, sweeps = _configurations(path, content.get("configurations"))
    if "until" in content and not sweeps:
        _refuse(path, "until", content["until"], "a sweep among the configurations is needed")
    claims = content.get("claims", ())
    if claims != "thesis":
        claims = tuple(_items(path, "claims", claims))
        for k, claim in enumerate(claims):
            _check_claim(path, f"claims[{k}]", claim)
    left = _items(path, "leave_out", content.get("leave_out", ()))
    for item in left:
        _check_selector(path, "leave_out", item)
    measures = _items(path, "measures", content.get("measures", list(MEASURES)))
    compare = _items(path, "compare", content.get("compare", ()))
    return StudyFile(
        title=content.get("title", ""),
        question=content.get("question", ""),
        folders=folders,
        sweeps=sweeps,
        compare=tuple(_comparison(path, f"compare[{k}]", c) for k, c in enumerate(compare)),
        measures=tuple(measures),
        claims=claims,
        level=float(content.get("level", LEVEL)),
        leave_out=tuple(left),
        budget=content.get("budget", BUDGET) if "until" in content else None,
        path=path,
    )


def _check_values(path: Path, content: Mapping[str, Any]) -> None:
    """Check the keys with simple values."""
    for measure in _items(path, "measures", content.get("measures", ())):
        if measure not in MEASURES:
            _refuse(path, "measures", measure, f"{', '.join(MEASURES)} are possible")
    for key, (right, allowed) in VALUES.items():
        if key in content and not right(content[key]):
            _refuse(path, key, content[key], allowed)
    if "budget" in content and "until" not in content:
        _refuse(path, "budget", content["budget"], "until: settled is needed")


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


def _configurations(path: Path, value: Any) -> tuple[tuple[Path, ...], tuple[tuple[str, ...], ...]]:
    folders: list[Path] = []
    sweeps: list[tuple[str, ...]] = []
    items = _items(path, "configurations", value if value is not None else ())
    for item in items:
        if isinstance(item, Mapping) and set(item) == {"sweep"}:
            words = item["sweep"]
            if not isinstance(words, list) or not all(isinstance(w, str) for w in words):
                _refuse(path, "sweep", words, "a list of overrides is possible: [strategy=a,b]")
            sweeps.append(tuple(words))
        elif isinstance(item, str):
            place = path.parent / Path(item).expanduser()
            found = [place] if place.is_dir() else _matching(place)
            if not found:
                _refuse(path, "configurations", item, "no such folder")
            folders += found
        else:
            _refuse(path, "configurations", item, "a folder, a glob or {sweep: [...]} is possible")
    return tuple(dict.fromkeys(folders)), tuple(sweeps)


def _matching(pattern: Path) -> list[Path]:
    """The folders that a glob means."""
    whole = pattern.absolute()
    return sorted(f for f in Path(whole.anchor).glob(str(whole)[len(whole.anchor) :]) if f.is_dir())


def _comparison(path: Path, where: str, item: Any) -> Effect | tuple[Selector, Selector]:
    allowed = "{effect_of: FACTOR, at_each: FACTOR} or a pair [first, second] is possible"
    if isinstance(item, Mapping) and "effect_of" in item and set(item) <= {"effect_of", "at_each"}:
        of, at = (_items(path, where, item.get(k, ())) for k in ("effect_of", "at_each"))
        if of and all(isinstance(word, str) for word in (*of, *at)):
            return Effect(tuple(of), tuple(at))
    if isinstance(item, list) and len(item) == 2:
        for selector in item:
            _check_selector(path, where, selector)
        return item[0], item[1]
    return _refuse(path, where, item, allowed)


def _check_claim(path: Path, where: str, claim: Any) -> None:
    if isinstance(claim, Mapping) and set(claim) == {"thesis"}:
        if claim["thesis"] not in (ids := [c.id for c in CLAIMS]):
            _refuse(path, where, claim["thesis"], f"statements of the thesis: {', '.join(ids)}")
        return
    if not isinstance(claim, Mapping) or not isinstance(claim.get("statement"), str):
        _refuse(path, where, claim, "a claim has a statement and one rule")
    rest = {k: v for k, v in claim.items() if k not in ("statement", "place", "definition")}
    if len(rest) != 1:
        _refuse(path, where, list(rest), f"one rule is needed: {', '.join(ALL_RULES)}")
    _check_rules(path, where, rest)


def _check_rules(path: Path, where: str, entry: Any) -> None:
    """Check every rule of a mapping from rules to their values."""
    if not isinstance(entry, Mapping) or not entry:
        _refuse(path, where, entry, f"rules are {', '.join(ALL_RULES)}")
    for name, value in entry.items():
        place = f"{where}.{name}"
        if name in ("all", "any"):
            for part in _items(path, place, value):
                _check_rules(path, place, part)
        elif name == "not":
            _check_rules(path, place, value)
        elif name not in RULES:
            _refuse(path, where, name, f"rules are {', '.join(ALL_RULES)}")
        else:
            _check_rule(path, place, name, value)


def _check_rule(path: Path, where: str, name: str, value: Any) -> None:
    needed, optional = RULES[name]
    if not isinstance(value, Mapping):
        _refuse(path, where, value, f"a mapping with {', '.join(needed + optional)} is possible")
    if name == "passes" and len({"above", "below"} & set(value)) != 1:
        _refuse(path, where, dict(value), "above or below is needed")
    for key in (*needed, *value):
        if key not in value or key not in (*needed, *optional):
            _refuse(path, f"{where}.{key}", value.get(key), f"keys: {', '.join(needed + optional)}")
        allowed = _wrong(key, value[key])
        if key == "high" and not allowed and not value["low"] < value["high"]:
            allowed = f"more than low={value['low']} is possible"
        if allowed:
            _refuse(path, f"{where}.{key}", value[key], allowed)


def _wrong(key: str, value: Any) -> str:
    """What is allowed, if the value of a rule's key is not; otherwise empty."""
    if key in ("of", "first", "second"):
        return "" if _is_selector(value) else SELECTORS
    if key == "measure":
        return "" if value in UNITS else f"{', '.join(UNITS)} are possible"
    if not _number(value):
        return "a number is possible"
    share = key in ("above", "below") and not 0 < value < 1
    return "a share between 0 and 1 is possible" if share else ""


def _check_selector(path: Path, where: str, value: Any) -> None:
    if not _is_selector(value):
        _refuse(path, where, value, SELECTORS)


def _is_selector(value: Any) -> bool:
    return isinstance(value, str) or (isinstance(value, Mapping) and bool(value))


def _items(path: Path, key: str, value: Any) -> list[Any]:
    if isinstance(value, str):
        return [value]
    if not isinstance(value, list | tuple):
        _refuse(path, key, value, "a list is possible")
    return list(value)


def _refuse(path: Path, key: str, value: Any, allowed: str) -> Any:
    raise ResultsError(f"{path}: {key}={value!r}: {allowed}")
