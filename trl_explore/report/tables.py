"""A table, and its CSV, LaTeX and Markdown; the template of the page writes HTML."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import pandas as pd

Record = Mapping[str, Any]


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
