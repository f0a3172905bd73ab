"""Tables as CSV, LaTeX and Markdown; numbers with their intervals as text."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import pandas as pd

from trl_explore.statistics.estimates import Estimate

Record = Mapping[str, Any]
MOST = 6
"""Most names that a sentence lists."""
FEW = 3
"""Most values of one parameter that it lists."""


@dataclass(frozen=True)
class Column:
    """A column for readers: its key in the records, its title and its text.

    ``numeric`` columns are right-aligned and sorted by the value of ``key``; ``wide`` columns hold
    sentences.
    """

    key: str
    title: str
    text: Callable[[Record], str]
    numeric: bool = False
    wide: bool = False
    css: Callable[[Record], str] | None = None

    def classes(self, record: Record) -> str:
        """The CSS classes of a cell."""
        extra = self.css(record) if self.css else ""
        return " ".join(w for w in ("num" * self.numeric, "wide" * self.wide, extra) if w)

    def value(self, record: Record) -> str:
        """The value that the page sorts by."""
        return plain(record.get(self.key))


def plain_columns(*keys: str) -> list[Column]:
    """Columns of values as they are, whose title is their key."""
    return [Column(key, key, lambda r, key=key: str(r[key])) for key in keys]


def estimates(titles: Mapping[str, str]) -> list[Column]:
    """Columns of estimates with their intervals: key -> title."""
    return [Column(key, title, estimate_cell(key), True) for key, title in titles.items()]


@dataclass(frozen=True)
class Table:
    """Records with all numbers, and the columns that readers see.

    ``kind`` is a CSS class.
    """

    id: str
    title: str
    columns: Sequence[Column]
    records: Sequence[Record]
    main: bool = False
    kind: str = ""

    def to_csv(self) -> str:
        """CSV of every key of every record, in full precision."""
        keys = list(dict.fromkeys(key for record in self.records for key in record))
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(map(_cell, keys))
        writer.writerows([[_cell(record.get(key)) for key in keys] for record in self.records])
        return buffer.getvalue()

    def rows(self) -> list[list[str]]:
        """The texts that readers see."""
        return [[column.text(record) for column in self.columns] for record in self.records]

    def to_markdown(self) -> str:
        """Markdown pipe table."""
        lines = [
            [_markdown(c.title) for c in self.columns],
            ["---:" if c.numeric else "---" for c in self.columns],
            *([_markdown(text) for text in row] for row in self.rows()),
        ]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"

    def to_latex(self) -> str:
        """LaTeX ``tabular`` with booktabs rules."""
        align = "".join(
            "p{0.22\\linewidth}" if c.wide else "r" if c.numeric else "l" for c in self.columns
        )
        frame = pd.DataFrame(
            [[_latex(text) for text in row] for row in self.rows()],
            columns=[_latex(c.title) for c in self.columns],
        )
        body = frame.to_latex(index=False, escape=False, column_format=align)
        return f"% {_latex(self.title)}\n{body}"


def plain(value: Any) -> str:
    """A value in full precision; None is empty, booleans are ``true`` and ``false``."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return repr(float(value)) if isinstance(value, float) else str(value)


def _cell(value: Any) -> str:
    """The text of a CSV cell; one that a spreadsheet would run as a formula starts with ``'``."""
    text = plain(value).replace("\r", " ")  # which the writer does not quote
    formula = isinstance(value, str) and text.lstrip()[:1] in tuple("=+-@")
    return f"'{text}" if formula else text


def _markdown(text: str) -> str:
    safe = escape("".join(c if c.isprintable() else " " for c in text), quote=False)
    return re.sub(r"([\\`*_|\[\]#])", r"\\\1", safe)


_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "ε": r"$\varepsilon$", "−": "$-$", "≥": r"$\geq$",
    "±": r"$\pm$", "∞": r"$\infty$", "§": r"\S{}", "½": r"$\frac12$", "–": "--", "×": r"$\times$",
    "“": "``", "”": "''", "γ": r"$\gamma$", "π": r"$\pi$", "μ": r"$\mu$",
    "σ": r"$\sigma$", "δ": r"$\delta$", "β": r"$\beta$", "’": "'", "…": r"\dots{}", "\n": " ",
}  # fmt: skip


def _latex(text: str) -> str:
    """Escape text for LaTeX: no commands, no comments, no line breaks."""
    return "".join(_LATEX.get(c, c if c.isprintable() else " ") for c in text)


def listed(words: Sequence[str]) -> str:
    """Words as a list in a sentence.

    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def some(words: Sequence[str]) -> str:
    """Words as a list; of more than ``MOST`` different ones, the first and a count.

    Values of one parameter are named by the first and the last of them.

    >>> some([f"{k}x" for k in range(9)]), some(["T = 1", "T = 2", "T = 4", "T = 8"])
    ('0x, 1x, 2x, 3x, 4x, 5x and 3 more', 'T = 1, …, 8 (4 values)')
    """
    words = list(dict.fromkeys(words))
    parts = [word.rpartition(" = ") for word in words]
    if len(words) > FEW and len({(name, sign) for name, sign, _ in parts}) == 1 and parts[0][1]:
        return f"{parts[0][0]} = {parts[0][2]}, …, {parts[-1][2]} ({len(words)} values)"
    more = [f"{len(words) - MOST} more"] * (len(words) > MOST)
    return listed([*words[:MOST], *more])


def span(counts: Iterable[int]) -> str:
    """The least and the greatest number, or the only one.

    >>> span([30, 1000, 30]), span([30])
    ('30 to 1,000', '30')
    """
    ends = sorted(set(counts))
    return f"{ends[0]:,}" if len(ends) == 1 else f"{ends[0]:,} to {ends[-1]:,}"


def capital(text: str) -> str:
    """The text as the beginning of a sentence; ε has no capital."""
    return text[:1].upper() + text[1:] if text[:1].isascii() else text


def uncapital(sentence: str) -> str:
    """A sentence as it continues another; a symbol (T = 1) keeps its capital."""
    return sentence if sentence[1:2] == " " else sentence[:1].lower() + sentence[1:]


def rounded(x: float) -> str:
    """A number with at least three significant digits.

    >>> rounded(1234.5), rounded(44.68), rounded(-0.01234), rounded(math.inf)
    ('1,234', '44.7', '−0.0123', '∞')
    """
    if not math.isfinite(x):
        return "–" if math.isnan(x) else "∞" if x > 0 else "−∞"
    size = abs(x)
    digits = 0 if size >= 99.95 or size == 0 else 1 if size >= 9.995 else 2
    text = f"{x:,.{digits}f}" if size >= 0.9995 or size == 0 else f"{x:.3g}"
    return _signed(text)


def interval(e: Estimate) -> str:
    """An estimate with its interval.

    >>> interval(Estimate(27.31, 24.08, 30.6)), interval(Estimate(1.0, math.nan, math.nan))
    ('27.3 [24.1, 30.6]', '1.00')
    """
    if math.isnan(e.low) or (e.low, e.high) == (-math.inf, math.inf):
        return rounded(e.value)
    return f"{rounded(e.value)} [{rounded(e.low)}, {rounded(e.high)}]"


def negated(e: Estimate) -> Estimate:
    """The estimate of −θ.

    >>> negated(Estimate(1.0, 0.5, 2.0))
    Estimate(value=-1.0, low=-2.0, high=-0.5, level=0.95)
    """
    return Estimate(-e.value, -e.high, -e.low, e.level)


def percent(e: Estimate | None) -> str:
    """A share with its interval in percent; a dash for None.

    >>> percent(Estimate(0.914, 0.9, 0.922)), percent(Estimate(math.nan, math.nan, math.nan))
    ('91 % [90, 92]', 'not estimable')
    """
    if e is None:
        return "–"
    if math.isnan(e.value):
        return "not estimable"
    value, low, high = (_signed(f"{100 * x:,.0f}") for x in (e.value, e.low, e.high))
    return f"{value} % [{low}, {high}]"


def p_value(p: float) -> str:
    """A p-value with its sign of relation.

    >>> p_value(0.04), p_value(0.00004)
    ('= 0.04', '< 0.001')
    """
    return "< 0.001" if p < 0.001 else f"= {p:.3f}".rstrip("0").rstrip(".")


def p_cell(key: str) -> Callable[[Record], str]:
    """The text of a p-value in a column."""
    return lambda r: p_value(r[key]).removeprefix("= ")


def estimate_cell(
    key: str, text: Callable[[float], str] = rounded, infinite: str = "∞"
) -> Callable[[Record], str]:
    """The text of an estimate in a column, with its interval in a second line."""

    def write(r: Record) -> str:
        value, low, high = r[key], r[f"{key}_low"], r[f"{key}_high"]
        if value is None or math.isnan(value):
            return "–"
        main = infinite if value == math.inf else text(value)
        known = [math.isfinite(low), math.isfinite(high)]
        if math.isnan(low) or math.isnan(high) or low == math.inf or not any(known):
            return main
        if not all(known):
            return f"{main}\n{f'{text(low)} or more' if known[0] else f'{text(high)} or less'}"
        return f"{main}\n[{text(low)}, {text(high)}]"

    return write


def rate_cell(prefix: str = "") -> Callable[[Record], str]:
    """The text of a pass rate in a column: ``0 of 20``, and its interval in a second line."""

    def write(r: Record) -> str:
        low, high = 100 * r[f"{prefix}pass_rate_low"], 100 * r[f"{prefix}pass_rate_high"]
        diverged = f", {r['diverged']} diverged" if r["diverged"] else ""
        return f"{r[f'{prefix}converged']} of {r['n']}{diverged}\n[{low:.0f}, {high:.0f}] %"

    return write


def _signed(text: str) -> str:
    """The text with a proper minus, and none before zero."""
    nothing = not text.strip("-0.")
    return text.removeprefix("-") if nothing else text.replace("-", "−")
