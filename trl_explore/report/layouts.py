"""Layouts of configurations: rows crossed with options, a plane of two parameters, sizes of a task.

A layout decides which pairs are compared, how the figures are arranged, and what is said.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trl_explore.names import OPTIONS, strategy_label, symbol
from trl_explore.report.factors import factors_of, label_parts, swept_parameters
from trl_explore.report.table_formats import capital, some
from trl_explore.statistics.comparisons import Comparison
from trl_explore.statistics.estimates import LEVEL, pass_rate
from trl_explore.statistics.outcomes import Outcomes

THESIS: Mapping[str, float] = {"epsilon": 0.0, "temperature": 1.0}
"""The thesis's softmax as a point of the mixtures of softmax and random actions."""
SIZE = "env.kwargs.size"
"""The key of the size of a task."""
PLANE_FROM = 3
"""Fewest values of each parameter of a plane."""


@dataclass(frozen=True)
class Crossed:
    """Rows (strategies, temperatures) crossed with the options of one group.

    Attributes:
        of: label of the group, for example ``correction``.
        rows, options: labels; each option is compared with the first.
        cells: (row, option) -> name of the configuration; some may be missing.
    """

    of: str
    rows: tuple[str, ...]
    options: tuple[str, ...]
    cells: Mapping[tuple[int, int], str]

    def pairs(self) -> list[tuple[str, str]]:
        """Names of configurations: (first option, other option) of every row."""
        return [
            (self.cells[row, 0], name)
            for (row, option), name in sorted(self.cells.items())
            if option and (row, 0) in self.cells
        ]


@dataclass(frozen=True)
class Plane:
    """Two parameters of one strategy, both varied.

    Attributes:
        x, y: labels of the parameters; ``xs`` and ``ys``: their values, ascending.
        cells: (index in xs, index in ys) -> name of the configuration; some may be missing.
        reference: the thesis's configuration, if it is one of the cells.
    """

    x: str
    y: str
    xs: tuple[float, ...]
    ys: tuple[float, ...]
    cells: Mapping[tuple[int, int], str]
    reference: str | None

    def pairs(self) -> list[tuple[str, str]]:
        """Names of configurations: (reference, other) for every other point."""
        if self.reference is None:
            return []
        others = (name for _, name in sorted(self.cells.items()) if name != self.reference)
        return [(self.reference, name) for name in others]


def crossed(configurations: Sequence[Outcomes]) -> Crossed | None:
    """The layout of configurations that differ in one option and in other factors.

    The options are those of the only group of ``OPTIONS`` that is a factor. Of two factors, the
    second is the option if none or both are such groups.
    """
    factors = factors_of(configurations)
    groups = [f for f in factors if f.key in OPTIONS]
    if len(factors) == 2 and len(groups) != 1:
        groups = [factors[1]]
    if len(groups) != 1:
        return None
    (of,) = groups
    rows: dict[str, int] = {}
    options: dict[str, int] = {}
    cells: dict[tuple[int, int], str] = {}
    for c in configurations:
        row = ", ".join(w for f in factors if f is not of and (w := f.words[c.name]))
        place = (
            rows.setdefault(row, len(rows)),
            options.setdefault(of.words[c.name], len(options)),
        )
        if place in cells:
            return None
        cells[place] = c.name
    if len(rows) < 2 or len(options) < 2 or len(cells) == len(rows):
        return None
    return Crossed(of.label, tuple(rows), tuple(options), cells)


def plane(configurations: Sequence[Outcomes]) -> Plane | None:
    """The layout of configurations that differ in two numeric parameters of their strategy."""
    keys = swept_parameters(configurations)
    if len(keys) != 2:
        return None
    points: dict[tuple[float, float], str] = {}
    for c in configurations:
        values = [c.parameters.get(key.removeprefix("strategy.")) for key in keys]
        numbers = [v for v in values if isinstance(v, int | float) and not isinstance(v, bool)]
        if len(numbers) < len(values):
            return None
        x, y = map(float, numbers)
        points[x, y] = c.name
    xs, ys = (tuple(sorted({point[k] for point in points})) for k in (0, 1))
    if min(len(xs), len(ys)) < PLANE_FROM or len(points) < len(configurations):
        return None
    cells = {(xs.index(x), ys.index(y)): name for (x, y), name in points.items()}
    thesis = [THESIS.get(key.removeprefix("strategy."), -1.0) for key in keys]
    reference = points.get((thesis[0], thesis[1]))
    return Plane(symbol(keys[0]), symbol(keys[1]), xs, ys, cells, reference)


Lines = Mapping[str, Mapping[float, Outcomes]]
"""Strategy -> size -> its configuration."""


def lines_by_size(configurations: Sequence[Outcomes]) -> dict[str, Lines]:
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


def pairs_by_size(configurations: Sequence[Outcomes]) -> list[tuple[Outcomes, Outcomes]]:
    """The planned pairs: the first strategy and each other one, at the same size."""
    found = []
    for panel in lines_by_size(configurations).values():
        first, *others = panel.values()
        found += [(first[n], c) for line in others for n, c in line.items() if n in first]
    return found


def size_sentence(configurations: Sequence[Outcomes]) -> str:
    """How many trials of every strategy passed at the largest size."""
    largest = max(map(size_of, configurations))
    texts = []
    for title, panel in lines_by_size(configurations).items():
        last = {name: line[largest] for name, line in panel.items() if largest in line}
        shares = [f"{strategy_label(n)} {c.converged.sum()} of {len(c)}" for n, c in last.items()]
        if shares:
            texts.append((f"{title}: " if title else "") + ", ".join(shares))
    return f"Passed at size {largest:g}: {'; '.join(texts)}."


def option_sentences(
    comparisons: Sequence[Comparison], cells: Mapping[str, tuple[str, str]]
) -> tuple[str, ...]:
    """One sentence for each option: where it needs fewer or more iterations than the first option.

    ``comparisons`` are those of the first option with another in the same row, corrected together;
    ``cells`` has the labels of the (row, option) of each configuration.
    """
    by: dict[str, list[tuple[str, Comparison]]] = {}
    for c in comparisons:
        row, option = cells[c.b]
        by.setdefault(option, []).append((row, c))
    sentences = []
    for option, found in by.items():
        first = cells[found[0][1].a][1]
        parts = []
        for word, sign in (("fewer", 1), ("more", -1)):
            rows = [
                f"{row} ({sign * c.difference.value:,.0f})"
                for row, c in found
                if c.winner == (c.b if sign > 0 else c.a)
            ]
            if rows:
                parts.append(f"{word} iterations under {some(rows)}")
        for same, text in (
            ("identical", "identical trials under"),
            ("neither passes", "no trial passes with either under"),
            ("", "no significant difference under"),
        ):
            rows = [row for row, c in found if c.winner is None and c.same == same]
            parts += [f"{text} {some(rows)}"] if rows else []
        sentences.append(f"{capital(option)} against {first}: {'; '.join(parts)}.")
    return tuple(sentences)


def plane_sentences(
    configurations: Sequence[Outcomes],
    comparisons: Sequence[Comparison],
    labels: Mapping[str, str],
    level: float = LEVEL,
) -> tuple[str, ...]:
    """State which points of a plane pass, which is fastest, and which beat the reference."""
    rates = [pass_rate(int(c.converged.sum()), len(c), level=level) for c in configurations]
    best = min(configurations, key=lambda c: float(c.durations.mean()))
    text = (
        f"Of {len(configurations)} points, {sum(r.above(0.8) for r in rates)} pass in more than"
        f" 80 % of trials and {sum(r.below(0.2) for r in rates)} in less than 20 % (intervals of"
        f" {100 * level:g} %). {capital(labels[best.name])} has the smallest mean,"
        f" {best.durations.mean():.0f} iterations; as the best of many, it is optimistic."
    )
    if not comparisons:
        return (text,)
    faster = [c for c in comparisons if c.winner == c.b]
    slower = [c for c in comparisons if c.winner == c.a]
    named = f": {some([labels[c.b] for c in faster])}" if faster else ""
    return (
        text,
        f"Against {labels[comparisons[0].a]}, the thesis’s softmax, {len(faster)} of"
        f" {len(comparisons)} points need significantly fewer iterations after Holm’s correction"
        f"{named}; {len(slower)} need significantly more.",
    )
