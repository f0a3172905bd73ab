"""Questions: which configurations differ in one factor only, and which factors are confounded.

The effect of a factor is asked within *blocks*: configurations that agree in every other factor.
Where a factor changes only together with others, no comparison separates them; the page then says
so and names the job that would.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from shlex import quote

from trl_explore.report.factors import Factor
from trl_explore.report.table_formats import listed

RATE = "optimizer.lr"
Pair = tuple[str, str]
"""Names of two configurations."""


@dataclass(frozen=True)
class Block:
    """Configurations that differ only in the factors of a question; ``where`` names the others."""

    where: str
    names: tuple[str, ...]


@dataclass(frozen=True)
class Question:
    """The effect of one factor, or of several together, at each level of all others."""

    factors: tuple[Factor, ...]
    blocks: tuple[Block, ...]

    @property
    def of(self) -> str:
        """What the effect is of: ``strategy``, ``strategy and learning rate together``."""
        names = listed([factor.label for factor in self.factors])
        return names if len(self.factors) == 1 else f"{names} together"

    @property
    def pairs(self) -> list[Pair]:
        """All pairs within the blocks."""
        return [pair for block in self.blocks for pair in combinations(block.names, 2)]

    def word(self, name: str) -> str:
        """The level of a configuration, for readers."""
        words = [f.words[name] for f in self.factors]
        return ", ".join(w for w in words if w)


@dataclass(frozen=True)
class Confound:
    """Factors that only change together.

    Attributes:
        factors: their labels.
        names: the configurations that nothing separates, and what they are most similar to.
        commands: jobs that would separate the factors, as commands; empty if they are not known.
    """

    factors: tuple[str, ...]
    names: tuple[str, ...]
    commands: tuple[str, ...]


def ask(names: Sequence[str], factors: Sequence[Factor], of: Sequence[Factor]) -> Question | None:
    """The question about some factors; None if no two configurations differ only in them."""
    rest = [f for f in factors if f not in of]
    blocks: dict[tuple[str, ...], list[str]] = {}
    for name in names:
        blocks.setdefault(tuple(f.levels[name] for f in rest), []).append(name)
    found = [
        Block(", ".join(w for f in rest if (w := f.words[members[0]])), tuple(members))
        for members in blocks.values()
        if len(members) > 1
    ]
    return Question(tuple(of), tuple(found)) if found else None


def inferred(names: Sequence[str], factors: Sequence[Factor]) -> list[Question]:
    """One question for every factor that is varied while all others are held."""
    asked = (ask(names, factors, [factor]) for factor in factors)
    return [question for question in asked if question is not None]


def confounds(
    names: Sequence[str], factors: Sequence[Factor], commands: Mapping[str, Sequence[str]]
) -> list[Confound]:
    """The factors that never change alone, and configurations that have no partner.

    ``commands`` has the overrides of the job of each configuration.
    """
    if len(factors) < 2:
        return []
    asked = inferred(names, factors)
    compared = {name for question in asked for block in question.blocks for name in block.names}
    found: dict[tuple[str, ...], list[Pair]] = {}
    for name in names:
        if name in compared:
            continue
        others = [other for other in names if other != name]
        nearest = min(others, key=lambda other: len(differing(factors, (name, other))))
        pair = (name, nearest) if names.index(name) < names.index(nearest) else (nearest, name)
        labels = tuple(factor.label for factor in differing(factors, pair))
        found.setdefault(labels, []).append(pair)
    return [
        Confound(
            labels,
            tuple(name for name in names if any(name in pair for pair in pairs)),
            tuple(dict.fromkeys(
                command
                for pair in dict.fromkeys(pairs)
                for command in separating(pair, differing(factors, pair), commands)
            )),
        )
        for labels, pairs in found.items()
    ]  # fmt: skip


def differing(factors: Sequence[Factor], pair: Pair) -> list[Factor]:
    """The factors in which two configurations differ."""
    return [f for f in factors if f.levels[pair[0]] != f.levels[pair[1]]]


def separating(
    pair: Pair, of: Sequence[Factor], commands: Mapping[str, Sequence[str]]
) -> tuple[str, ...]:
    """The jobs between two configurations, of which each changes one more factor to the second's.

    With them, any two neighbours differ in one factor.
    """
    first, second = (list(commands.get(name, ())) for name in pair)
    if not first and not second:
        return ()
    found = []
    for k in range(1, len(of)):
        changed = of[:k]
        kept = [word for word in first if not any(_belongs(word, f) for f in changed)]
        taken = [word for word in second if any(_belongs(word, f) for f in changed)]
        words = shown([*kept, *taken])
        # By default, the learning rate is that of the policy.
        for rate in (f for f in of if f.key == RATE and not any(_belongs(w, f) for w in words)):
            words.append(f"{RATE}={float(rate.levels[pair[rate in changed]]):g}")
        found.append(" ".join(["trl-explore train", *map(quote, words)]))
    return tuple(found)


def shown(command: Sequence[str]) -> list[str]:
    """The overrides without those for output, threads and restart."""
    skipped = ("output_dir=", "threads=", "restart=", "hydra.")
    return [word for word in command if not word.startswith(skipped)]


def _belongs(word: str, factor: Factor) -> bool:
    """Whether an override sets a factor: ``policy=mlp`` and ``policy.hidden=[8]`` the policy."""
    key = word.lstrip("+~").split("=", 1)[0]
    key = key.split("@")[-1]
    if key == factor.key or key.startswith(f"{factor.key}."):
        # The learning rate is a factor of its own.
        return not (factor.key == "optimizer" and key == RATE)
    return False
