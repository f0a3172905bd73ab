"""Labels of configurations: the strategy, and what differs between them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from trl_explore.names import OPTIONS, STRATEGIES, option_label, strategy_label, symbol
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import AGENT_GROUPS, NO_AGENT

ASSUMED = "correction.strategy"
"""The key of the strategy that a correction names."""


def configuration_labels(configurations: Sequence[Outcomes]) -> dict[str, str]:
    """Map the name of every configuration to a short, unique label.

    A label has the strategy, if there are several, and what differs between configurations of the
    same strategy: ``ε-greedy``, ``softmax, T = 0.5``, ``softmax, per-step ratio``. With a single
    strategy it is only ``T = 0.5``. If such labels are not unique or are too long, all
    configurations keep their names.
    """
    parts = label_parts(configurations)
    labels = {
        c.name: ", ".join(parts[c.name].values()) or strategy_label(c.strategy)
        for c in configurations
    }
    clear = len(set(labels.values())) == len(labels) and max(map(len, labels.values()), default=0)
    return labels if clear and clear <= 60 else {c.name: c.name for c in configurations}


def label_parts(configurations: Sequence[Outcomes]) -> dict[str, dict[str, str]]:
    """Map the name of every configuration to the parts of its label: factor -> words.

    The factors are ``strategy`` (if there are several), keys of parameters, and configuration
    groups (``correction``).
    """
    several = len({c.strategy for c in configurations}) > 1
    values = {c.name: _flat(c) for c in configurations}
    parts = {}
    for c in configurations:
        own = values[c.name]
        keys = _varying([values[o.name] for o in configurations if o.strategy == c.strategy])
        words = {"strategy": strategy_label(c.strategy)} if several else {}
        if f"{ASSUMED}._target_" in own and any(key.startswith("correction.") for key in keys):
            words["correction"] = _assumed(own)
        for key in keys:
            if key.startswith("correction.") and "correction" in words:
                continue
            if key in own and not (key == "baseline.value" and "baseline._target_" in keys):
                words[key.removesuffix("._target_")] = _words(key, own)
        parts[c.name] = words
    return parts


def _assumed(flat: Mapping[str, Any]) -> str:
    """The strategy whose bias a correction has, with its parameters: ``bias of ε-greedy 0.3``."""
    target = str(flat[f"{ASSUMED}._target_"]).rsplit(".", 1)[-1]
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", target).lower()
    values = [
        _value(v)
        for k, v in flat.items()
        if k.startswith(f"{ASSUMED}.") and "._" not in k and _is_number(v)
    ]
    return " ".join([option_label("correction", "AsIf"), strategy_label(name), *values])


def _words(key: str, flat: Mapping[str, Any]) -> str:
    """One factor of a label: the name of an option, or a parameter and its value."""
    group, value = key.removesuffix("._target_"), flat[key]
    if key.endswith("._target_") and group in OPTIONS:
        name = str(value).rsplit(".", 1)[-1]
        if name == "Constant" and flat.get("baseline.value"):
            return f"baseline {_value(flat['baseline.value'])}"
        if name in OPTIONS[group]:
            return option_label(group, name)
    return f"{symbol(key)} = {_value(value)}"


def swept_parameters(configurations: Sequence[Outcomes]) -> list[str]:
    """Keys of the parameters in which configurations of one strategy differ.

    Empty if there are several strategies or fewer than two configurations.
    """
    if len({c.strategy for c in configurations}) != 1 or len(configurations) < 2:
        return []
    return _varying([_flat(c) for c in configurations])


def swept_parameter(configurations: Sequence[Outcomes]) -> str | None:
    """Label of the only parameter in which configurations of one strategy differ, or None."""
    keys = swept_parameters(configurations)
    return symbol(keys[0]) if len(keys) == 1 else None


def natural_order(configurations: Sequence[Outcomes]) -> list[Outcomes]:
    """Sort configurations: strategies as in the thesis, others by name; numbers ascending.

    Options of a group are sorted last, with the thesis's option first.
    """
    known = list(STRATEGIES)

    def key(c: Outcomes) -> tuple[Any, ...]:
        place = known.index(c.strategy) if c.strategy in known else len(known)
        flat = sorted(_flat(c).items(), key=lambda item: (_is_group(item[0]), item[0]))
        numbers = [(k, _rank(k, v), "" if _is_number(v) else repr(v)) for k, v in flat]
        return place, c.strategy, numbers, c.name

    return sorted(configurations, key=key)


def _is_group(key: str) -> bool:
    return key.split(".")[0] in AGENT_GROUPS


def _rank(key: str, value: Any) -> float:
    if _is_number(value):
        return float(value)
    names = list(OPTIONS.get(key.removesuffix("._target_"), ()))
    name = str(value).rsplit(".", 1)[-1]
    return float(names.index(name)) if name in names else float(len(names))


def _varying(flats: Sequence[Mapping[str, Any]]) -> list[str]:
    """The keys in which configurations differ.

    Arguments of a class are compared only among configurations with this class. Of keys that vary
    together (the weight of the loss and the learning rate, for example), only one is returned,
    preferably not that of the loss.
    """
    keys = dict.fromkeys(k for flat in flats for k in flat)
    patterns: dict[tuple[int, ...], str] = {}
    for key in sorted(keys, key=lambda k: k.split(".")[0] == "loss"):
        if not _varies(key, flats):
            continue
        seen: dict[str, int] = {}
        pattern = tuple(seen.setdefault(repr(f.get(key)), len(seen)) for f in flats)
        patterns.setdefault(pattern, key)
    return list(patterns.values())


def _varies(key: str, flats: Sequence[Mapping[str, Any]]) -> bool:
    target = f"{key.rpartition('.')[0]}._target_"
    values: dict[Any, set[str]] = {}
    for flat in flats:
        of = flat.get(target) if target != key else None
        values.setdefault(of, set()).add(repr(flat.get(key)))
    return any(len(found) > 1 for found in values.values())


def _flat(c: Outcomes) -> dict[str, Any]:
    flat: dict[str, Any] = {}

    def walk(prefix: str, node: Any) -> None:
        if isinstance(node, Mapping):
            for key, value in node.items():
                walk(f"{prefix}.{key}" if prefix else str(key), value)
        else:
            flat[prefix] = node

    walk("", c.parameters)
    for group in AGENT_GROUPS:
        walk(group, c.config.get(group, {}))
    stopping = {f"env.{key}" for key in NO_AGENT}
    return {k: v for k, v in flat.items() if not k.endswith("_partial_") and k not in stopping}


def _value(value: Any) -> str:
    if _is_number(value):
        return f"{value:g}"
    return str(value).rsplit(".", 1)[-1] if isinstance(value, str) else str(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
