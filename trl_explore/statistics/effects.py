"""What options do to rows, and where on a plane trials pass, in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trl_explore.statistics.comparisons import Comparison
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.proportions import pass_rate

MOST = 6
"""Names in a list of a sentence."""


def option_sentences(
    comparisons: Sequence[Comparison], cells: Mapping[str, tuple[str, str]]
) -> tuple[str, ...]:
    """One sentence for each option: where it needs fewer iterations than the first one, or more.

    Args:
        comparisons: of the first option with another one in the same row, corrected together.
        cells: name of a configuration -> (row, option), as readers call them.

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
                parts.append(f"{word} iterations under {_list(rows)}")
        same = [r for r, c in found if _identical(c)]
        if same:
            parts.append(f"the very same trials under {_list(same)}")
        never = [r for r, c in found if _never(c)]
        if never:
            parts.append(f"no trial passes with either under {_list(never)}")
        unclear = [r for r, c in found if c.winner is None and not _identical(c) and not _never(c)]
        if unclear:
            parts.append(f"no difference beyond chance under {_list(unclear)}")
        sentences.append(f"{_capital(option)} against {first}: {'; '.join(parts)}.")
    return tuple(sentences)


def plane_sentences(
    configurations: Sequence[Outcomes],
    comparisons: Sequence[Comparison],
    labels: Mapping[str, str],
    level: float,
) -> tuple[str, ...]:
    """How much of a plane passes, where it is fastest, and which points beat the reference."""
    rates = [pass_rate(int(c.converged.sum()), len(c), level=level) for c in configurations]
    best = min(configurations, key=lambda c: float(c.durations.mean()))
    text = (
        f"Of {len(configurations)} points, {sum(r.above(0.8) for r in rates)} pass in more than"
        f" 80 % of trials and {sum(r.below(0.2) for r in rates)} in less than 20 % (intervals of"
        f" {100 * level:g} %); the smallest mean, {best.durations.mean():.0f} iterations, was seen"
        f" at {labels[best.name]}, which as the best of so many is flattered by chance."
    )
    if not comparisons:
        return (text,)
    faster = [c for c in comparisons if c.winner == c.b]
    slower = [c for c in comparisons if c.winner == c.a]
    named = f": {_list([labels[c.b] for c in faster])}" if faster else ""
    return (
        text,
        f"Against {labels[comparisons[0].a]}, the thesis’s softmax, {len(faster)} of"
        f" {len(comparisons)} points need fewer iterations beyond chance after Holm’s correction"
        f"{named}; {len(slower)} need more.",
    )


def _identical(c: Comparison) -> bool:
    """Whether every trial took as many iterations under both, and some converged."""
    return c.sd == 0 and c.difference.value == 0 and not _never(c)


def _never(c: Comparison) -> bool:
    return c.mean_a == c.mean_b == c.cap


def _list(words: Sequence[str]) -> str:
    shown = [*words[:MOST], f"{len(words) - MOST} more"] if len(words) > MOST else list(words)
    return shown[0] if len(shown) == 1 else ", ".join(shown[:-1]) + " and " + shown[-1]


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:] if text[:1].isascii() else text  # ε has no capital
