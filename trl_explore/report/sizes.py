"""The layout of configurations that differ in the size of the task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trl_explore.names import strategy_label
from trl_explore.report.groups import SIZE
from trl_explore.report.labels import label_parts
from trl_explore.statistics.outcomes import Outcomes

Lines = Mapping[str, Mapping[float, Outcomes]]
"""Strategy -> size -> its configuration."""


def layout(configurations: Sequence[Outcomes]) -> dict[str, Lines]:
    """What else differs between the configurations -> the lines of a panel, sizes ascending."""
    parts = label_parts(configurations)
    panels: dict[str, dict[str, dict[float, Outcomes]]] = {}
    for c in sorted(configurations, key=size_of):
        words = [text for key, text in parts[c.name].items() if key not in ("strategy", SIZE)]
        panels.setdefault(", ".join(words), {}).setdefault(c.strategy, {})[size_of(c)] = c
    order = list(dict.fromkeys(c.strategy for c in configurations))
    return {
        title: {name: lines[name] for name in order if name in lines}
        for title, lines in sorted(panels.items())
    }


def size_of(c: Outcomes) -> float:
    """The size of the task of a configuration."""
    return float(c.config["env"]["kwargs"]["size"])


def pairs(configurations: Sequence[Outcomes]) -> list[tuple[Outcomes, Outcomes]]:
    """The planned pairs: the first strategy and each other one, at the same size."""
    found = []
    for panel in layout(configurations).values():
        first, *others = panel.values()
        found += [(first[n], c) for line in others for n, c in line.items() if n in first]
    return found


def sentence(configurations: Sequence[Outcomes]) -> str:
    """How many trials of every strategy passed at the largest size."""
    largest = max(map(size_of, configurations))
    texts = []
    for title, panel in layout(configurations).items():
        last = {name: line[largest] for name, line in panel.items() if largest in line}
        shares = [f"{strategy_label(n)} {c.converged.sum()} of {len(c)}" for n, c in last.items()]
        if shares:
            texts.append(f"{title}: " * bool(title) + ", ".join(shares))
    return f"Passed at size {largest:g}: {'; '.join(texts)}."
