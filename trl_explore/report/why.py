"""The section *Why* in sentences and tables: the parts of a difference by acting, bias, data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from trl_explore.report.decomposition import NEAR, QUANTITIES, Decomposition, Parts
from trl_explore.report.table_formats import (
    Column,
    Record,
    Table,
    interval,
    p_value,
    percent,
    plain_columns,
    rounded,
    some,
)
from trl_explore.statistics.estimates import Estimate, flat

MOST = 4
"""The most strategies in a sentence: those that differ most from softmax."""


class Words(NamedTuple):
    """How sentences name a quantity: "ε-greedy *needs* 30 *iterations* *fewer* than softmax"."""

    name: str
    verb: str
    unit: str
    fewer: str


WORDS = {
    "learning": Words("time to learning", "needs", "iterations", "fewer"),
    "height": Words("mean learned score", "has", "points", "less"),
    "passing": Words("time to passing", "needs", "iterations", "fewer"),
}
"""Of these the headline takes the first whose share can be estimated, else the first known."""


def headline(found: Sequence[Decomposition]) -> tuple[str, ...]:
    """One sentence each on acting, bias and data, for the strategies of the first environment.

    A sentence is missing if nothing of its kind was measured.
    """
    if not found:
        return ()
    first = [d for d in found if d.environment == found[0].environment]
    return tuple(s for s in (_acting_said(first), _bias_said(first), _data_said(first)) if s)


def _acting_said(found: Sequence[Decomposition]) -> str:
    known = [(d.strategy, d.acting["plain"]) for d in found if "plain" in d.acting]
    if not known:
        return ""
    known += [("softmax", a) for d in found[:1] if (a := d.acting.get("reference"))]
    known = known[:MOST] + known[-1:] if len(known) > MOST + 1 else known
    first, *others = known
    said = [
        f"{first[0]} scores {rounded(first[1].behaved.value)} with its exploration and"
        f" {rounded(first[1].learned.value)} without it",
        *(
            f"{name} {rounded(a.behaved.value)} and {rounded(a.learned.value)}"
            for name, a in others
        ),
    ]
    return (
        "Acting: an agent’s score while it explores is not what it has learned. With the same"
        f" weights, as a mean over training, {'; '.join(said)}."
    )


def _bias_said(found: Sequence[Decomposition]) -> str:
    quantity, parts = chosen_quantity(found)
    if not parts:
        return ""
    words = WORDS[quantity]
    shown, rest = _largest([pair for pair in parts if not np.isnan(pair[1].bias.value)])
    unclear = [pair for pair in parts if np.isnan(pair[1].bias.value)]
    said = [_share_said(strategy, p, words) for strategy, p in shown]
    none = ""
    if unclear:
        size = f" ({interval(unclear[0][1].gap)} {words.unit})" if len(unclear) == 1 else ""
        none = (
            f"no share can be estimated for {some([name for name, _ in unclear])}, whose difference"
            f" from softmax{size} is too uncertain or too small"
        )
    what = f"this explains {'; '.join(said)}{rest}" if said else ""
    return (
        "Bias: a gradient that treats the actions as if they came from the policy is biased; of the"
        f" {words.name}, {'; '.join(part for part in (what, none) if part)}."
    )


def _share_said(strategy: str, p: Parts, words: Words) -> str:
    """The share of the bias in the difference, by each way in which it was measured."""
    more = "more" if p.gap.value > 0 else words.fewer
    whole = (
        f"the {rounded(abs(p.gap.value))} {words.unit} that {strategy} {words.verb} {more} than"
        f" softmax ({rounded(p.plain)} against {rounded(p.reference)})"
    )
    known = [
        (share, how, name, change, sign)
        for share, how, name, change, sign in (
            (p.corrected, f"removed from {strategy}", strategy, "without the bias", -1),
            (p.assumed, "added to softmax", "softmax", "with it", 1),
        )
        if share is not None
    ]
    if p.separable:
        only = f", {known[0][1]}," if len(known) == 1 else ""
        return f"{percent(p.bias)}{only} of {whole}"
    if all(-NEAR <= share.value <= 1 + 3 * NEAR for share, *_ in known):
        known.sort(key=lambda way: way[0].value)
        low, high = (f"{percent(share)}, {how}," for share, how, *_ in known)
        return f"{low} to {high} of {whole}"
    changes = []  # the bias is not part of the difference
    for share, _, name, how, sign in known:
        change = sign * share.value * p.gap.value
        more = "more" if change > 0 else words.fewer
        changes.append(f"{how}, {name} {words.verb} {rounded(abs(change))} {words.unit} {more}")
    return f"no share of {whole}: {' and, '.join(changes)}"


def _data_said(found: Sequence[Decomposition]) -> str:
    quantity, parts = chosen_quantity(found, ["learning", "height"])
    words, said = WORDS[quantity], []
    known = [(strategy, p) for strategy, p in parts if p.data is not None]
    shown, rest = _largest([pair for pair in known if pair[1].told_apart])
    for strategy, p in shown:
        assert p.data is not None
        more = "more" if p.data.value > 0 else words.fewer
        low, high = sorted((abs(p.data.low), abs(p.data.high)))
        size = interval(Estimate(abs(p.data.value), low, high))
        said.append(f"{strategy} {words.verb} {size} {words.unit} {more} than softmax")
    same = [pair for pair in known if not pair[1].told_apart]
    if len(same) == 1 and (data := same[0][1].data):
        said.append(f"{same[0][0]} does not differ significantly ({interval(data)} {words.unit})")
    elif same:
        said.append(f"{some([name for name, _ in same])} do not differ significantly from softmax")
    if not said:
        return ""
    return (
        "Data: what is left with corrected gradients is the effect of exploration proper. By the"
        f" {words.name}, {'; '.join(said)}{rest}."
    )


def _largest(parts: Sequence[tuple[str, Parts]]) -> tuple[list[tuple[str, Parts]], str]:
    """The strategies that differ most from softmax, and how many others there are, in words."""
    if len(parts) <= MOST:
        return list(parts), ""
    shown = sorted(parts, key=lambda pair: -abs(pair[1].gap.value))[:MOST]
    return shown, f"; the table has {len(parts) - MOST} more"


def chosen_quantity(
    found: Sequence[Decomposition], names: Sequence[str] = tuple(WORDS)
) -> tuple[str, list[tuple[str, Parts]]]:
    """The quantity to report, and the parts of every strategy in it.

    Where hardly any trial learns within the cap, times are not informative, and the score is used.
    """
    known = {q: [(d.strategy, d.parts[q]) for d in found if q in d.parts] for q in names}
    told = [q for q in names if any(not np.isnan(p.bias.value) for _, p in known[q])]
    there = [q for q in names if known[q]]
    best = next(iter([*told, *there]), names[0])
    return best, known[best]


def decomposition_tables(found: Sequence[Decomposition]) -> list[Table]:
    """The main table, one row per strategy, and the table of all quantities; empty for none."""
    return [_main(found), _quantities(found)] if found else []


def _main(found: Sequence[Decomposition]) -> Table:
    by = {(d.environment, d.strategy): d for d in found}
    environments = dict.fromkeys(d.environment for d in found)
    quantity = {
        environment: chosen_quantity([d for d in found if d.environment == environment])[0]
        for environment in environments
    }

    def of(key: str, title: str, text: Callable[[Decomposition], str]) -> Column:
        return Column(key, title, lambda r: text(by[r["environment"], r["strategy"]]), True)

    def part(key: str, title: str, text: Callable[[Parts | None], str]) -> Column:
        return of(key, title, lambda d: text(d.parts.get(quantity[d.environment])))

    times = " or ".join(sorted({QUANTITIES[q] for q in quantity.values()}))
    columns = [
        *plain_columns("strategy"),
        of("handicap", "acting: score in training, and without exploration", _acting),
        part("gap", f"{times}: difference from softmax", _gap),
        part("bias", "bias: its share", _bias),
        part("data", "data: the same, corrected", _data),
        of("passes", "trials that pass", _passes),
    ]
    if set(quantity.values()) != {"passing"}:
        columns.insert(5, of("passing_bias", "bias: its share by passing",
                             lambda d: _bias(d.parts.get("passing"))))  # fmt: skip
    if len(environments) > 1:
        columns[:0] = plain_columns("environment")
    title = "Acting, bias and data: every strategy against softmax"
    records = [_record(d, quantity[d.environment]) for d in found]
    return Table("why-parts", title, columns, records, main=True, kind="cards")


def _record(d: Decomposition, quantity: str) -> dict[str, Any]:
    record: dict[str, Any] = {
        "environment": d.environment, "strategy": d.strategy, "quantity": quantity
    }  # fmt: skip
    if (shown := d.parts.get(quantity)) is not None:
        record |= {"gap": shown.gap, "bias": shown.bias, "data": shown.data}
    if (a := d.acting.get("plain")) is not None:
        record |= {"behaved": a.behaved, "learned": a.learned, "handicap": a.handicap}
    if d.acting_share is not None:
        record["acting_share"] = d.acting_share
    for quantity, p in d.parts.items():
        record |= {f"{quantity}_gap": p.gap, f"{quantity}_bias": p.bias}
        if p.data is not None:
            record |= {f"{quantity}_data": p.data, f"{quantity}_data_p": p.p_data}
    if d.passes is not None:
        record |= dict(zip(("passes", "passes_corrected", "trials"), d.passes, strict=True))
    return flat(record)


def _acting(d: Decomposition) -> str:
    a = d.acting.get("plain")
    if a is None:
        return "–"
    lines = f"{rounded(a.behaved.value)} and {rounded(a.learned.value)}\n{interval(a.handicap)}"
    known = d.acting_share is not None and not np.isnan(d.acting_share.value)
    return f"{lines}\nshare {percent(d.acting_share)}" if known else lines


def _gap(p: Parts | None) -> str:
    return "–" if p is None else f"{interval(p.gap)}\n{rounded(p.plain)} − {rounded(p.reference)}"


def _bias(p: Parts | None) -> str:
    if p is None:
        return "–"
    if p.assumed is None or p.corrected is None or np.isnan(p.bias.value):
        return percent(p.bias)
    ways = f"added: {percent(p.assumed)}\nremoved: {percent(p.corrected)}"
    return f"{percent(p.bias)}\n{ways}" if p.separable else f"{ways}\nmean: {percent(p.bias)}"


def _data(p: Parts | None) -> str:
    if p is None or p.data is None or p.p_data is None:
        return "–"
    return f"{interval(p.data)}\np {p_value(p.p_data)}"


def _passes(d: Decomposition) -> str:
    if d.passes is None:
        return "–"
    plain, corrected, n = d.passes
    return f"{plain:,} of {n:,},\ncorrected {corrected:,}"


def _quantities(found: Sequence[Decomposition]) -> Table:
    by = {(d.environment, d.strategy, q): p for d in found for q, p in d.parts.items()}
    records = [
        flat({"environment": environment, "strategy": strategy} | vars(p))
        for (environment, strategy, _), p in by.items()
    ]

    def of(key: str, title: str, text: Callable[[Any], str]) -> Column:
        def cell(r: Record) -> str:
            value = getattr(by[r["environment"], r["strategy"], r["quantity"]], key)
            return "–" if value is None else text(value)

        return Column(key, title, cell, True)

    columns = [
        *plain_columns("environment", "strategy"),
        Column("quantity", "quantity", lambda r: QUANTITIES[r["quantity"]]),
        of("plain", "uncorrected", rounded),
        of("reference", "softmax", rounded),
        of("gap", "difference", interval),
        of("assumed", "bias, added", percent),
        of("corrected", "bias, removed", percent),
        of("bias", "bias, mean of these", percent),
        of("data", "data", interval),
        of("p_data", "p of data (Holm)", p_value),
        of("n", "trials", "{:,}".format),
    ]
    return Table("why-quantities", "Bias and data in every quantity", columns, records, main=True)
