"""What things are called in figures and tables: names for readers instead of keys."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from trl_explore.analysis.outcomes import Outcomes
from trl_explore.analysis.pairing import AGENT_GROUPS

STRATEGIES = {
    "random": "random",
    "argmax": "argmax",
    "epsilon_greedy": "ε-greedy",
    "decaying_epsilon_greedy": "decaying ε-greedy",
    "softmax": "softmax",
    "boltzmann": "Boltzmann",
    "mixture": "mixture",
    "max_boltzmann": "max-Boltzmann",
    "epsilon_softmax": "ε-softmax",
    "epsilon_z_greedy": "ε-z-greedy",
    "vdbe": "VDBE",
    "count_bonus": "count bonus",
    "parameter_noise": "parameter noise",
}
SYMBOLS = {
    "epsilon": "ε", "decay": "decay rate", "temperature": "T", "sigma": "σ", "delta": "δ",
    "beta": "β",
}  # fmt: skip
EXPERIMENTS = {
    "thesis": "The five strategies",
    "epsilon_grid": "The choice of ε",
    "decay_grid": "The choice of the decay rate",
}


def strategy_label(name: str) -> str:
    """A strategy as readers call it: ``epsilon_greedy`` is ε-greedy.

    >>> strategy_label("upper_bound")
    'upper bound'
    """
    return STRATEGIES.get(name, name.replace("_", " "))


def readable(text: str) -> str:
    """Text of the analysis with the names of strategies as readers call them, and minus signs.

    >>> readable("softmax minus decaying_epsilon_greedy")
    'softmax minus decaying ε-greedy'
    """
    pattern = rf"\b({'|'.join(STRATEGIES)})\b"
    text = re.sub(pattern, lambda match: STRATEGIES[match[1]], text)
    return re.sub(r"(?<![\w.)])-(?=\d)", "−", text)


def configuration_labels(configurations: Sequence[Outcomes]) -> dict[str, str]:
    """Map the name of every configuration to a short label that tells it from the others.

    The strategy, where there are several, and what differs between configurations of the same
    strategy: ``ε-greedy``, ``softmax, T = 0.5``; of one strategy alone only ``T = 0.5``.
    Configurations that this would not tell apart keep their names.
    """
    several = len({c.strategy for c in configurations}) > 1
    values = {c.name: _flat(c) for c in configurations}
    labels = {}
    for c in configurations:
        siblings = [values[o.name] for o in configurations if o.strategy == c.strategy]
        keys = _varying(siblings)
        own = values[c.name]
        parts = [f"{_symbol(k)} = {_value(own[k])}" for k in keys if k in own]
        if several or not parts:
            parts.insert(0, strategy_label(c.strategy))
        labels[c.name] = ", ".join(parts)
    clear = len(set(labels.values())) == len(labels) and max(map(len, labels.values()), default=0)
    return labels if clear and clear <= 60 else {c.name: c.name for c in configurations}


def swept_parameter(configurations: Sequence[Outcomes]) -> str | None:
    """The one parameter in which configurations of one strategy differ, as readers call it."""
    if len({c.strategy for c in configurations}) != 1 or len(configurations) < 2:
        return None
    keys = _varying([_flat(c) for c in configurations])
    return _symbol(keys[0]) if len(keys) == 1 else None


def natural_order(configurations: Sequence[Outcomes]) -> list[Outcomes]:
    """Strategies in the order of the thesis, others by name; numbers of a grid ascending."""
    known = list(STRATEGIES)

    def key(c: Outcomes) -> tuple[Any, ...]:
        place = known.index(c.strategy) if c.strategy in known else len(known)
        flat = sorted(_flat(c).items())
        numbers = [(k, float(v), "") if _is_number(v) else (k, 0.0, repr(v)) for k, v in flat]
        return place, c.strategy, numbers, c.name

    return sorted(configurations, key=key)


def _varying(flats: Sequence[Mapping[str, Any]]) -> list[str]:
    """The keys in which configurations differ.

    Of keys that vary together, as where the weight of the loss follows the learning rate, only
    one is named, and not that of the loss.
    """
    keys = dict.fromkeys(k for flat in flats for k in flat)
    patterns: dict[tuple[int, ...], str] = {}
    for key in sorted(keys, key=lambda k: k.split(".")[0] == "loss"):
        seen: dict[str, int] = {}
        pattern = tuple(seen.setdefault(repr(f.get(key)), len(seen)) for f in flats)
        if len(seen) > 1:
            patterns.setdefault(pattern, key)
    return list(patterns.values())


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
    return {k: v for k, v in flat.items() if not k.endswith("_partial_")}


def _symbol(key: str) -> str:
    last = key.rsplit(".", 1)[-1].strip("_").replace("_", " ")
    parameter = SYMBOLS.get(key.split(".", 1)[0], key.split(".", 1)[0])
    if key in SYMBOLS or last == "target":
        return parameter
    return f"{last} {parameter}" if key.split(".", 1)[0] in SYMBOLS else last


def _value(value: Any) -> str:
    if _is_number(value):
        return f"{value:g}"
    return str(value).rsplit(".", 1)[-1] if isinstance(value, str) else str(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
