"""A table once, written as CSV, LaTeX and Markdown; the template of the page writes it as HTML."""

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
    """A column for readers: its key in the records, its title, and how a record is written.

    ``numeric`` columns are aligned right and sorted by the value under ``key``; ``wide`` ones
    hold sentences.
    """

    key: str
    title: str
    text: Callable[[Record], str]
    numeric: bool = False
    wide: bool = False
    css: Callable[[Record], str] | None = None

    def classes(self, record: Record) -> str:
        """The classes of a cell in the page."""
        extra = self.css(record) if self.css else ""
        return " ".join(w for w in ("num" * self.numeric, "wide" * self.wide, extra) if w)

    def value(self, record: Record) -> str:
        """The value that a cell of the page is sorted by."""
        return plain(record.get(self.key))


@dataclass(frozen=True)
class Table:
    """Records with all their numbers, and the columns that readers see of them.

    ``kind`` is a class of the page's style sheet.
    """

    id: str
    title: str
    columns: Sequence[Column]
    records: Sequence[Record]
    main: bool = False
    kind: str = ""

    def to_csv(self) -> str:
        """Every key of every record in full precision."""
        keys = list(dict.fromkeys(key for record in self.records for key in record))
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(keys)
        writer.writerows([[plain(record.get(key)) for key in keys] for record in self.records])
        return buffer.getvalue()

    def rows(self) -> list[list[str]]:
        """What readers see."""
        return [[column.text(record) for column in self.columns] for record in self.records]

    def to_markdown(self) -> str:
        """A pipe table."""
        lines = [
            [_markdown(c.title) for c in self.columns],
            ["---:" if c.numeric else "---" for c in self.columns],
            *([_markdown(text) for text in row] for row in self.rows()),
        ]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"

    def to_latex(self) -> str:
        """A ``tabular`` with the rules of booktabs."""
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
    """A value for a machine: floats in full, nothing for None, words for booleans."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return repr(float(value)) if isinstance(value, float) else str(value)


def _markdown(text: str) -> str:
    safe = escape("".join(c if c.isprintable() else " " for c in text), quote=False)
    return re.sub(r"([\\`*_|\[\]#])", r"\\\1", safe)


_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "ε": r"$\varepsilon$", "−": "$-$", "≥": r"$\geq$",
    "±": r"$\pm$", "∞": r"$\infty$", "§": r"\S{}", "½": r"$\frac12$", "–": "--", "×": r"$\times$",
    "“": "``", "”": "''", "γ": r"$\gamma$", "\n": " ",
}  # fmt: skip


def _latex(text: str) -> str:
    """Text for LaTeX: nothing in it is a command, and nothing ends a line or a comment."""
    return "".join(_LATEX.get(c, c if c.isprintable() else " ") for c in text)
