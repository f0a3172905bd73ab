"""A table once, written as HTML, CSV, LaTeX and Markdown: the same numbers in all of them."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

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
        writer.writerows([[_plain(record.get(key)) for key in keys] for record in self.records])
        return buffer.getvalue()

    def to_html(self) -> str:
        """A table that scrolls sideways by itself; each cell carries the value it is sorted by."""
        head = "".join(
            f'<th scope="col"{_class("num" if c.numeric else "")}>{escape(c.title)}</th>'
            for c in self.columns
        )
        body = "".join(f"<tr>{''.join(map(self._cell, self.columns, [r] * len(self.columns)))}</tr>"
                       for r in self.records)  # fmt: skip
        return (
            f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(self.title)}">'
            f'<table class="{f"sortable {self.kind}".strip()}" id="{escape(self.id)}">'
            f"<caption>{escape(self.title)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
        )

    def _cell(self, column: Column, record: Record) -> str:
        text = escape(column.text(record)).replace("\n", "<br>")
        extra = column.css(record) if column.css else ""
        words = " ".join(w for w in ("num" * column.numeric, "wide" * column.wide, extra) if w)
        value = escape(_plain(record.get(column.key)))
        label = escape(column.title)
        return f'<td{_class(words)} data-value="{value}" data-label="{label}">{text}</td>'

    def to_markdown(self) -> str:
        """A pipe table."""
        lines = [
            [_markdown(c.title) for c in self.columns],
            ["---:" if c.numeric else "---" for c in self.columns],
            *([_markdown(c.text(r)) for c in self.columns] for r in self.records),
        ]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"

    def to_latex(self) -> str:
        """A ``tabular`` with the rules of booktabs."""
        align = "".join(
            "p{0.22\\linewidth}" if c.wide else "r" if c.numeric else "l" for c in self.columns
        )
        rows = [" & ".join(_latex(c.text(r)) for c in self.columns) for r in self.records]
        head = " & ".join(_latex(c.title) for c in self.columns)
        body = "".join(f"{row} \\\\\n" for row in rows)
        return (
            f"% {_latex(self.title)}\n"
            f"\\begin{{tabular}}{{{align}}}\n\\toprule\n{head} \\\\\n\\midrule\n"
            f"{body}\\bottomrule\n\\end{{tabular}}\n"
        )


def _class(words: str) -> str:
    return f' class="{words}"' if words else ""


def _plain(value: Any) -> str:
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
