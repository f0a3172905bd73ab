"""The tables of acting, bias and data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from trl_explore.report.decomposition import QUANTITIES, Decomposition, Parts
from trl_explore.report.numbers import figure, interval, p_value, percent
from trl_explore.report.tables import Column, Record, Table
from trl_explore.statistics.estimates import flat


def decomposition_tables(found: Sequence[Decomposition]) -> list[Table]:
    """The main table, one row per strategy, and the table of all quantities; empty for none."""
    return [_main(found), _quantities(found)] if found else []


def _main(found: Sequence[Decomposition]) -> Table:
    by = {(d.environment, d.strategy): d for d in found}

    def of(text: Callable[[Decomposition], str]) -> Callable[[Record], str]:
        return lambda r: text(by[r["environment"], r["strategy"]])

    columns = [
        Column("strategy", "strategy", lambda r: r["strategy"]),
        Column("handicap", "acting: score in training, and without exploration",
               of(_acting), True),
        Column("acting_share", "acting: share in the difference of training scores",
               of(lambda d: percent(d.acting_share)), True),
        Column("learning_gap", "iterations to learning, minus softmax’s",
               of(lambda d: _gap(d.parts.get("learning"))), True),
        Column("learning_bias", "bias: share in this difference",
               of(lambda d: _bias(d.parts.get("learning"))), True),
        Column("learning_data", "data: the difference with corrected gradients",
               of(lambda d: _data(d.parts.get("learning"))), True),
        Column("passing_bias", "bias: share by time to passing",
               of(lambda d: percent(p.bias if (p := d.parts.get("passing")) else None)), True),
        Column("passes", "trials that pass", of(_passes), True),
    ]  # fmt: skip
    if len({d.environment for d in found}) > 1:
        columns.insert(0, Column("environment", "environment", lambda r: r["environment"]))
    title = "Acting, bias and data: every strategy against softmax"
    return Table("why-parts", title, columns, [_record(d) for d in found], main=True)


def _record(d: Decomposition) -> dict[str, Any]:
    record: dict[str, Any] = {"environment": d.environment, "strategy": d.strategy}
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
    return f"{interval(a.behaved)}\n{interval(a.learned)}\n+ {interval(a.handicap)}"


def _gap(p: Parts | None) -> str:
    return "–" if p is None else f"{interval(p.gap)}\n{figure(p.plain)} − {figure(p.reference)}"


def _bias(p: Parts | None) -> str:
    if p is None:
        return "–"
    lines = [percent(p.bias)]
    if p.assumed is not None and p.corrected is not None:
        lines += [f"added: {percent(p.assumed)}", f"removed: {percent(p.corrected)}"]
    return "\n".join(lines)


def _data(p: Parts | None) -> str:
    if p is None or p.data is None or p.p_data is None:
        return "–"
    return f"{interval(p.data)}\np {p_value(p.p_data)}"


def _passes(d: Decomposition) -> str:
    if d.passes is None:
        return "–"
    plain, corrected, n = d.passes
    return f"{plain:,} of {n:,}\ncorrected: {corrected:,}"


def _quantities(found: Sequence[Decomposition]) -> Table:
    by = {(d.environment, d.strategy, q): p for d in found for q, p in d.parts.items()}
    records = [
        flat({"environment": environment, "strategy": strategy} | vars(p))
        for (environment, strategy, _), p in by.items()
    ]

    def of(key: str, text: Callable[[Any], str]) -> Callable[[Record], str]:
        def cell(r: Record) -> str:
            value = getattr(by[r["environment"], r["strategy"], r["quantity"]], key)
            return "–" if value is None else text(value)

        return cell

    columns = [
        Column("environment", "environment", lambda r: r["environment"]),
        Column("strategy", "strategy", lambda r: r["strategy"]),
        Column("quantity", "quantity", lambda r: QUANTITIES[r["quantity"]]),
        Column("plain", "uncorrected", of("plain", figure), True),
        Column("reference", "softmax", of("reference", figure), True),
        Column("gap", "difference", of("gap", interval), True),
        Column("assumed", "bias, added", of("assumed", percent), True),
        Column("corrected", "bias, removed", of("corrected", percent), True),
        Column("bias", "bias, mean of both", of("bias", percent), True),
        Column("data", "data", of("data", interval), True),
        Column("p_data", "p of data (Holm)", of("p_data", p_value), True),
        Column("n", "trials", of("n", "{:,}".format), True),
    ]
    return Table("why-quantities", "Bias and data in every quantity", columns, records, main=True)
