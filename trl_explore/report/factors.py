"""Factors: the settings in which configurations differ, and the labels that they give.

A setting is a group of the configuration (``policy``, ``correction``) or one of its keys
(``optimizer.lr``). If configurations have different classes of a group, the class with its own
arguments is one factor; otherwise every argument that differs is one. A schedule is one value.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from trl_explore.names import OPTIONS, STRATEGIES, option_label, option_of, strategy_label, symbol
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import AGENT_GROUPS, NO_AGENT, canonical

Flat = Mapping[str, Any]
"""Key within a group -> value; ``_target_`` is the class."""
LONGEST = 90
"""Most characters of a label."""


@dataclass(frozen=True)
class Factor:
    """A setting that is not the same for all configurations.

    Attributes:
        key: ``strategy``, ``correction``, ``optimizer.lr``, ...
        label: its name for readers.
        levels: name of a configuration -> canonical text of its value; equal texts, equal values.
        words: name of a configuration -> its value for readers: ``T = 0.5``, ``per-step ratio``.
    """

    key: str
    label: str
    levels: Mapping[str, str]
    words: Mapping[str, str]

    def has(self, key: str) -> bool:
        """Whether a user's word means this factor: its key, the end of its key, or its label."""
        return key in (self.key, self.key.rsplit(".", 1)[-1], self.label)


def factors_of(configurations: Sequence[Outcomes]) -> list[Factor]:
    """Every factor of the configurations, the strategy first."""
    found = []
    for group in ("strategy", *AGENT_GROUPS):
        flats = {c.name: arguments(c, group) for c in configurations}
        classes = {name: _class(flat) for name, flat in flats.items()}
        if len(set(classes.values())) > 1:
            found += _of_classes(group, flats, classes)
        else:
            keys = sorted({key for flat in flats.values() for key in flat})
            found += [_of_key(group, key, flats) for key in keys]
    return [f for f in found if len(set(f.levels.values())) > 1]


def configuration_labels(configurations: Sequence[Outcomes]) -> dict[str, str]:
    """Map the name of every configuration to a unique label that names every factor.

    ``ε-greedy``; ``softmax, T = 0.5``; ``softmax, per-step ratio, learning rate = 0.01``; with a
    single strategy only ``T = 0.5``. If such labels are not unique or are too long, configurations
    keep their names.
    """
    parts = label_parts(configurations)
    labels = {
        c.name: ", ".join(parts[c.name].values()) or strategy_label(c.strategy)
        for c in configurations
    }
    clear = len(set(labels.values())) == len(labels)
    longest = max(map(len, labels.values()), default=0)
    return labels if clear and longest <= LONGEST else {c.name: c.name for c in configurations}


def label_parts(configurations: Sequence[Outcomes]) -> dict[str, dict[str, str]]:
    """Map the name of every configuration to the parts of its label: key of a factor -> words."""
    factors = factors_of(configurations)
    return {
        c.name: {f.key: f.words[c.name] for f in factors if f.words[c.name]} for c in configurations
    }


def swept_parameters(configurations: Sequence[Outcomes]) -> list[str]:
    """Keys of the factors of configurations of one strategy.

    Empty if there are several strategies or fewer than two configurations.
    """
    if len({c.strategy for c in configurations}) != 1 or len(configurations) < 2:
        return []
    return [factor.key for factor in factors_of(configurations)]


def swept_parameter(configurations: Sequence[Outcomes]) -> str | None:
    """Label of the only factor of configurations of one strategy, or None."""
    keys = swept_parameters(configurations)
    return symbol(keys[0]) if len(keys) == 1 else None


def natural_order(configurations: Sequence[Outcomes]) -> list[Outcomes]:
    """Sort configurations: strategies as in the thesis, others by name; numbers ascending.

    Options of a group are sorted last, with the thesis's option first.
    """
    known = list(STRATEGIES)

    def key(c: Outcomes) -> tuple[Any, ...]:
        place = known.index(c.strategy) if c.strategy in known else len(known)
        numbers = [
            (group != "strategy", group, key, _rank(group, key, value), canonical(value))
            for group in ("strategy", *AGENT_GROUPS)
            for key, value in sorted(arguments(c, group).items())
        ]
        return place, c.strategy, numbers, c.name

    return sorted(configurations, key=key)


def settings_of(c: Outcomes) -> dict[str, str]:
    """The settings of a configuration in words: label -> value, the strategy first."""
    found: dict[str, str] = {}
    for group in ("strategy", *AGENT_GROUPS):
        flat = arguments(c, group)
        own = {
            key: value
            for key, value in flat.items()
            if key not in ("_target_", "id", "lr", "name", "functional", "reduction")
            and value not in ({}, [], None, False)
        }
        if group == "loss" or "" in own:
            found |= {symbol(f"{group}.{k}" if k else group): value_words(v)
                      for k, v in own.items() if v != 0}  # fmt: skip
            continue
        words = str(flat.get("id", "unknown")) if group == "env" else class_words(group, flat)
        said = ("strategy",) if group == "correction" else ("value",)
        shown = [f"{symbol(f'{group}.{key}')} = {value_words(value)}"
                 for key, value in own.items() if key not in said]  # fmt: skip
        if words:
            found[group_label(group)] = f"{words} ({', '.join(shown)})" if shown else words
        if group == "optimizer" and "lr" in flat:
            found[symbol("optimizer.lr")] = value_words(flat["lr"])
    return found


def arguments(c: Outcomes, group: str) -> dict[str, Any]:
    """The class of a group and its arguments: key -> value.

    A mapping with a class of its own, such as a schedule, is one value.
    """
    if group == "strategy":
        return {"_target_": c.strategy, **_leaves(c.parameters)}
    value = c.config.get(group)
    if group not in OPTIONS and not isinstance(value, Mapping):
        return {} if value is None else {"": value}
    flat = _leaves(value if isinstance(value, Mapping) else {})
    if group in OPTIONS:
        flat["_target_"] = option_of(c.config, group)
    if group == "policy":
        flat.pop("lr", None)  # the default of the optimiser's, which is a factor of its own
    if group == "env":
        flat = {k: v for k, v in flat.items() if k not in NO_AGENT}
        if flat.get("max_steps") == flat.get("kwargs.size"):  # the size says it
            flat.pop("max_steps", None)
    optimizer = c.config.get("optimizer")
    if group == "loss" and isinstance(optimizer, Mapping) and "lr" in optimizer:
        # By default the weight is the learning rate (appendix A.3 of the thesis).
        flat = {k: v for k, v in flat.items() if k != "weight" or v != optimizer["lr"]}
    return flat


def group_label(group: str) -> str:
    """The name of a group for readers: ``optimizer`` -> optimiser."""
    return {"env": "environment", "optimizer": "optimiser"}.get(group, group.replace("_", " "))


def class_words(group: str, flat: Flat) -> str:
    """The class of a group in words; of a user's class, its name: ``MyBaseline`` -> my baseline."""
    name = str(flat.get("_target_") or "")
    if group == "strategy":
        return strategy_label(name)
    name = name.rsplit(".", 1)[-1]
    if name == "Constant" and flat.get("value"):
        return f"baseline {value_words(flat['value'])}"
    if group == "correction" and isinstance(mimicked := flat.get("strategy"), Mapping):
        return f"{option_label('correction', name)} {_strategy_words(mimicked)}"
    if name == "torch_optimizer":
        return str(flat.get("name"))
    if name == "LaneAdam":
        return "Adam"
    return OPTIONS.get(group, {}).get(name) or _spaced(name)


def value_words(value: Any) -> str:
    """A value for readers; a schedule shows where it begins and ends: ``2 → 0.5 (linear)``."""
    if _is_number(value):
        return f"{value:g}"
    if isinstance(value, Mapping) and "_target_" in value:
        return _schedule_words(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(value_words, value))}]"
    return str(value).rsplit(".", 1)[-1] if isinstance(value, str) else str(value)


def _of_classes(group: str, flats: Mapping[str, Flat], classes: Mapping[str, str]) -> list[Factor]:
    """The factor of the class; arguments that are varied within a class and common to all."""
    common = set.intersection(*(set(flat) for flat in flats.values())) - {"_target_", "name"}
    apart = sorted(k for k in common if k == "lr" or _varies_within(k, flats, classes))
    own = {n: {k: v for k, v in f.items() if k not in apart} for n, f in flats.items()}
    words = {}
    for name, flat in own.items():
        alike = [own[n] for n, c in classes.items() if c == classes[name]]
        shown = [class_words(group, flat)]
        for key, value in flat.items():
            said = key == "_target_" or (group, key) in (("correction", "strategy"),
                                                         ("baseline", "value"))  # fmt: skip
            differs = len({canonical(f.get(key)) for f in alike}) > 1
            if not said and (differs or (isinstance(value, Mapping) and "_target_" in value)):
                shown.append(f"{symbol(f'{group}.{key}')} = {value_words(value)}")
        words[name] = ", ".join(shown)
    levels = {name: canonical(flat) for name, flat in own.items()}
    return [Factor(group, group_label(group), levels, words),
            *(_of_key(group, key, flats) for key in apart)]  # fmt: skip


def _of_key(group: str, key: str, flats: Mapping[str, Flat]) -> Factor:
    full = f"{group}.{key}" if key else group
    label = symbol(full)
    levels = {name: canonical(flat.get(key)) for name, flat in flats.items()}
    words = {
        name: f"{label} = {value_words(flat[key])}" if key in flat else ""
        for name, flat in flats.items()
    }
    if full == "correction.strategy":
        label, words = "correction", {n: class_words("correction", f) for n, f in flats.items()}
    return Factor(full, label, levels, words)


def _varies_within(key: str, flats: Mapping[str, Flat], classes: Mapping[str, str]) -> bool:
    seen: dict[str, set[str]] = {}
    for name, flat in flats.items():
        seen.setdefault(classes[name], set()).add(canonical(flat.get(key)))
    return any(len(values) > 1 for values in seen.values())


def _class(flat: Flat) -> str:
    return f"{flat.get('_target_')} {flat.get('name', '')}"


def _leaves(node: Mapping[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in node.items():
        if isinstance(value, Mapping) and "_target_" not in value:
            flat |= {f"{key}.{k}": v for k, v in _leaves(value).items()}
        elif key not in ("_partial_", "_recursive_", "_convert_"):
            flat[str(key)] = value
    return flat


def _rank(group: str, key: str, value: Any) -> float:
    if _is_number(value):
        return float(value)
    names = list(OPTIONS.get(group, ())) if key == "_target_" else []
    name = str(value).rsplit(".", 1)[-1]
    return float(names.index(name)) if name in names else float(len(names))


def _strategy_words(node: Mapping[str, Any]) -> str:
    """A strategy that is named by its class, with its parameters: ``ε-greedy 0.3``."""
    target = str(node.get("_target_")).rsplit(".", 1)[-1]
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", target).lower()
    values = [value_words(v) for k, v in node.items() if k[0] != "_" and not isinstance(v, str)]
    return " ".join([strategy_label(name), *values])


def _schedule_words(node: Mapping[str, Any]) -> str:
    kind = str(node["_target_"]).rsplit(".", 1)[-1].lower()
    knots = node.get("knots")
    if isinstance(knots, list | tuple) and knots:
        return f"{value_words(knots[0][-1])} → {value_words(knots[-1][-1])} ({kind})"
    rest = [f"{symbol(k)} {value_words(v)}" for k, v in node.items()
            if k[0] != "_" and k not in ("initial", "final", "iterations")]  # fmt: skip
    start = value_words(node.get("initial", "?"))
    if "final" in node:
        length = f" in {value_words(node['iterations'])}" if "iterations" in node else ""
        return f"{start} → {value_words(node['final'])}{length} ({', '.join([kind, *rest])})"
    limit = "0 " if kind in ("exponential", "inverse") else ""
    return f"{start} → {limit}({', '.join([kind, *rest])})"


def _spaced(name: str) -> str:
    """The words of a name in code: ``MyBaseline`` and ``my_baseline`` -> my baseline."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name).replace("_", " ").lower()


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
