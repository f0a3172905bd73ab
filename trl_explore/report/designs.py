"""How configurations are laid out: rows crossed with options, or a plane of two numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trl_explore.report.labels import label_parts, swept_parameters, symbol
from trl_explore.statistics.choices import NAMES, choice, choice_name
from trl_explore.statistics.outcomes import Outcomes

THESIS: Mapping[str, float] = {"epsilon": 0.0, "temperature": 1.0}
"""The thesis's softmax as a point of the family that mixes softmax with chance."""
PLANE_FROM = 3
"""Fewest values of either parameter of a plane."""


@dataclass(frozen=True)
class Crossed:
    """Rows (strategies, temperatures) crossed with the options of one group.

    Attributes:
        of: the group, ``correction``.
        rows: what readers call the rows.
        options: what readers call the options; the first is the one the others are held against.
        cells: (row, option) -> name of the configuration; some may be missing.

    """

    of: str
    rows: tuple[str, ...]
    options: tuple[str, ...]
    cells: Mapping[tuple[int, int], str]

    def pairs(self) -> list[tuple[str, str]]:
        """(first option, other option) of every row, as names of configurations."""
        return [
            (self.cells[row, 0], name)
            for (row, option), name in sorted(self.cells.items())
            if option and (row, 0) in self.cells
        ]


@dataclass(frozen=True)
class Plane:
    """Values of two numbers, all of one strategy.

    Attributes:
        x: what readers call the first.
        y: what readers call the second.
        xs: its values, ascending.
        ys: those of the second.
        cells: (place in xs, place in ys) -> name of the configuration; some may be missing.
        reference: the configuration of the thesis among them, if there is one.

    """

    x: str
    y: str
    xs: tuple[float, ...]
    ys: tuple[float, ...]
    cells: Mapping[tuple[int, int], str]
    reference: str | None

    def pairs(self) -> list[tuple[str, str]]:
        """(reference, other) for every other point."""
        if self.reference is None:
            return []
        others = (name for _, name in sorted(self.cells.items()) if name != self.reference)
        return [(self.reference, name) for name in others]


def crossed(configurations: Sequence[Outcomes]) -> Crossed | None:
    """The layout of configurations that differ in the option of one group and in something else."""
    parts = label_parts(configurations)
    groups = {key for words in parts.values() for key in words if key in NAMES}
    if len(groups) != 1:
        return None
    (of,) = groups
    rows: dict[str, int] = {}
    options: dict[str, int] = {}
    cells: dict[tuple[int, int], str] = {}
    for c in configurations:
        words = dict(parts[c.name])
        option = words.pop(of, "") or choice_name(choice(c, of), of)
        row = rows.setdefault(", ".join(words.values()), len(rows))
        place = row, options.setdefault(option, len(options))
        if place in cells:
            return None
        cells[place] = c.name
    if len(rows) < 2 or len(options) < 2:
        return None
    return Crossed(of, tuple(rows), tuple(options), cells)


def plane(configurations: Sequence[Outcomes]) -> Plane | None:
    """The layout of configurations that differ in two numbers of their strategy."""
    keys = swept_parameters(configurations)
    if len(keys) != 2:
        return None
    points: dict[tuple[float, float], str] = {}
    for c in configurations:
        values = [c.parameters.get(key) for key in keys]
        if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
            return None
        x, y = (float(v) for v in values)  # type: ignore[arg-type]
        points[x, y] = c.name
    xs, ys = (tuple(sorted({point[k] for point in points})) for k in (0, 1))
    if min(len(xs), len(ys)) < PLANE_FROM or len(points) < len(configurations):
        return None
    cells = {(xs.index(x), ys.index(y)): name for (x, y), name in points.items()}
    thesis = [THESIS.get(key, -1.0) for key in keys]
    reference = points.get((thesis[0], thesis[1]))
    return Plane(symbol(keys[0]), symbol(keys[1]), xs, ys, cells, reference)
