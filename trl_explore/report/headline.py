"""The answer to *why* in three sentences: acting, bias, data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trl_explore.report.decomposition import Decomposition, Parts
from trl_explore.report.numbers import figure, interval, percent
from trl_explore.statistics.estimates import Estimate


class Words(NamedTuple):
    """How a quantity is spoken of: "ε-greedy *needs* 30 *iterations* *fewer* than softmax"."""

    name: str
    verb: str
    unit: str
    fewer: str


WORDS = {
    "learning": Words("time to learning", "needs", "iterations", "fewer"),
    "height": Words("mean learned score", "has", "points", "less"),
    "passing": Words("time to passing", "needs", "iterations", "fewer"),
}
"""Quantities of the headline: the first of which a share can be estimated, or that is known."""


def headline(found: Sequence[Decomposition]) -> tuple[str, ...]:
    """One sentence each on acting, bias and data, for the strategies of the first environment.

    A sentence is missing if nothing of its kind was measured.
    """
    if not found:
        return ()
    first = [d for d in found if d.environment == found[0].environment]
    return tuple(s for s in (_acting(first), _bias(first), _data(first)) if s)


def _acting(found: Sequence[Decomposition]) -> str:
    known = [(d.strategy, d.acting["plain"]) for d in found if "plain" in d.acting]
    if not known:
        return ""
    known += [("softmax", a) for d in found[:1] if (a := d.acting.get("reference"))]
    first, *others = known
    said = [
        f"{first[0]} scores {figure(first[1].behaved.value)} with its exploration and"
        f" {figure(first[1].learned.value)} without it",
        *(f"{name} {figure(a.behaved.value)} and {figure(a.learned.value)}" for name, a in others),
    ]
    return (
        "Acting: an agent’s score while it explores is not what it has learned. With the same"
        f" weights, as a mean over training, {'; '.join(said)}."
    )


def _bias(found: Sequence[Decomposition]) -> str:
    quantity, parts = chosen_quantity(found)
    if not parts:
        return ""
    words, said = WORDS[quantity], []
    for strategy, p in parts:
        more = "more" if p.gap.value > 0 else words.fewer
        whole = (
            f"the {figure(abs(p.gap.value))} {words.unit} that {strategy} {words.verb} {more} than"
            f" softmax ({figure(p.plain)} against {figure(p.reference)})"
        )
        if np.isnan(p.bias.value):
            said.append(
                f"nothing clear of {strategy}, which hardly differs from softmax"
                f" ({interval(p.gap)} {words.unit})"
            )
        elif p.separable:
            said.append(f"{percent(p.bias)} of {whole}")
        else:
            ways = [(p.corrected, f"removed from {strategy}"), (p.assumed, "added to softmax")]
            low, high = (f"{percent(share)}, {how}," for share, how in sorted(ways, key=_value))
            said.append(f"{low} to {high} of {whole}")
    return (
        "Bias: a gradient that treats the actions as if they came from the policy is biased; of the"
        f" {words.name}, this explains {'; '.join(said)}."
    )


def _data(found: Sequence[Decomposition]) -> str:
    quantity, parts = chosen_quantity(found, ["learning", "height"])
    words, said = WORDS[quantity], []
    for strategy, p in parts:
        if p.data is None:
            continue
        if p.told_apart:
            more = "more" if p.data.value > 0 else words.fewer
            low, high = sorted((abs(p.data.low), abs(p.data.high)))
            size = interval(Estimate(abs(p.data.value), low, high))
            said.append(f"{strategy} {words.verb} {size} {words.unit} {more} than softmax")
        else:
            said.append(
                f"{strategy} does not differ significantly ({interval(p.data)} {words.unit})"
            )
    if not said:
        return ""
    return (
        "Data: what is left with corrected gradients is the effect of exploration proper. By the"
        f" {words.name}, {'; '.join(said)}."
    )


def chosen_quantity(
    found: Sequence[Decomposition], names: Sequence[str] = tuple(WORDS)
) -> tuple[str, list[tuple[str, Parts]]]:
    """The quantity to speak of, and the parts of every strategy in it.

    Where hardly any trial learns within the cap, times tell nothing, and the score is taken.
    """
    known = {q: [(d.strategy, d.parts[q]) for d in found if q in d.parts] for q in names}
    told = [q for q in names if any(not np.isnan(p.bias.value) for _, p in known[q])]
    there = [q for q in names if known[q]]
    best = next(iter([*told, *there]), names[0])
    return best, known[best]


def _value(way: tuple[Estimate | None, str]) -> float:
    return way[0].value if way[0] is not None else np.nan
