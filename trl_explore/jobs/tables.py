"""Reading a table: strict, so that a damaged file is noticed, and light, as there may be many.

A file of this program is one line of names and lines of as many fields, each line ended. Nothing
is quoted, skipped, guessed or filled in: a cut or changed file is refused, not read as another one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.jobs.columns import ResultsError

INTEGER = re.compile(r"-?[0-9]{1,19}")
NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
BOOLS = {"True": True, "False": False}

Parser = Callable[[Sequence[str]], NDArray[Any]]


def integers(texts: Sequence[str]) -> NDArray[np.int64]:
    """Decimal integers of 64 bits [n]; a ValueError says what is none."""
    _check(texts, INTEGER, "an integer")
    try:
        return np.array(list(map(int, texts)), dtype=np.int64)
    except OverflowError:
        raise ValueError("holds an integer of more than 64 bits") from None


def numbers(texts: Sequence[str]) -> NDArray[np.float64]:
    """Finite float64s [n]; a ValueError says what is none.

    Example:
        >>> numbers(["1", "2.5e-1"]).tolist()
        [1.0, 0.25]
        >>> numbers(["nan"])
        Traceback (most recent call last):
        ...
        ValueError: holds 'nan', which is not a finite number
    """
    _check(texts, NUMBER, "a finite number")
    values = np.array(list(map(float, texts)), dtype=np.float64)
    if not np.isfinite(values).all():
        raise ValueError("holds a number too large for float64")
    return values


def booleans(texts: Sequence[str]) -> NDArray[np.bool_]:
    """``True`` and ``False`` [n]; a ValueError says what is neither."""
    return np.array([BOOLS[t] for t in words(texts, BOOLS)], dtype=np.bool_)


def words(texts: Sequence[str], allowed: Sequence[str] | Mapping[str, Any]) -> Sequence[str]:
    """The texts, all of them among the allowed ones; a ValueError says which is not."""
    for text in set(texts):
        if text not in allowed:
            raise ValueError(f"holds {_shown(text)}; allowed are {', '.join(allowed)}")
    return texts


def _check(texts: Sequence[str], pattern: re.Pattern[str], what: str) -> None:
    if not all(map(pattern.fullmatch, texts)):
        wrong = next(text for text in texts if not pattern.fullmatch(text))
        raise ValueError(f"holds {_shown(wrong)}, which is not {what}")


def _shown(text: str) -> str:
    return repr(text if len(text) <= 30 else f"{text[:27]}...")


def read_table(
    path: Path, parsers: Mapping[str, Parser], *, header: bool = True
) -> dict[str, NDArray[Any]]:
    """The columns of a table, each read by its parser; other columns are left alone.

    Args:
        path: the file.
        parsers: name of a column -> what turns its texts [n] into an array [n], or raises
            ValueError saying what is wrong with them.
        header: whether the first line names the columns; if not, they are those of ``parsers``.

    Raises:
        ResultsError: if the file is missing, cut off, or not such a table.
    """
    rows = _fields(path)
    names = rows.pop(0) if header else list(parsers)
    for number, fields in enumerate(rows, start=1 + header):
        if len(fields) != len(names):
            raise ResultsError(f"{path}: line {number} has {len(fields)} fields, not {len(names)}")
    missing = [name for name in parsers if name not in names]
    if missing:
        raise ResultsError(f"{path}: no column {', '.join(missing)}")
    twice = [name for name in parsers if names.count(name) > 1]
    if twice:
        raise ResultsError(f"{path}: the column {twice[0]} stands there twice")
    texts = dict(zip(names, zip(*rows, strict=True), strict=True)) if rows else {}
    columns = {}
    for name, parse in parsers.items():
        try:
            columns[name] = parse(texts.get(name, ()))
        except ValueError as error:
            raise ResultsError(f"{path}: column {name} {error}") from None
    return columns


def _fields(path: Path) -> list[list[str]]:
    """The fields of every line."""
    try:
        text = path.read_bytes().decode()
    except FileNotFoundError:
        raise ResultsError(f"{path}: missing") from None
    except OSError as error:
        raise ResultsError(f"{path}: not readable ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ResultsError(f"{path}: not readable as CSV (it is not UTF-8)") from None
    if not text.endswith("\n"):
        raise ResultsError(f"{path}: cut off, its last line has no end")
    return [line.removesuffix("\r").split(",") for line in text[:-1].split("\n")]
