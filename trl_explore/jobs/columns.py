"""The names and columns of a job's files, and how each column is written and read.

A table is a line of column names, then lines with one field per column; every line ends with a
newline. Parsing is strict: no quoting, skipping, guessing or filling in. A truncated or changed
file is rejected.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trl_explore.jobs.files import ResultsError, read_file
from trl_explore.statistics.evaluations import PURPOSES
from trl_explore.statistics.outcomes import STATUSES

TRIALS, EPISODES, SCALARS = "trials.csv", "episodes.csv", "scalars"
EVALUATIONS, TIMINGS = "evaluations.csv", "timings.csv"
WEIGHTS, KEPT, VISITS = "weights.safetensors", "kept_weights.safetensors", "visits.safetensors"
FILES = (TRIALS, EPISODES, EVALUATIONS, WEIGHTS, KEPT, VISITS)
"""The results of a job beside ``scalars/`` and ``run.json``."""
PACKAGES = ("trl_explore", "torch", "torchrl", "tensordict", "gymnasium", "numpy", "numba")
INTEGER = re.compile(r"-?[0-9]{1,19}")
NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
BOOLS = {"True": True, "False": False}

Parser = Callable[[Sequence[str]], NDArray[Any]]


def integers(texts: Sequence[str]) -> NDArray[np.int64]:
    """Parse decimal 64-bit integers [n]; a ValueError names the text that is not one."""
    _check(texts, INTEGER, "an integer")
    try:
        return np.array(list(map(int, texts)), dtype=np.int64)
    except OverflowError:
        raise ValueError("holds an integer that exceeds 64 bits") from None


def numbers(texts: Sequence[str]) -> NDArray[np.float64]:
    """Parse finite float64 numbers [n]; a ValueError names the text that is not one.

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
    """Parse ``True`` and ``False`` [n]; a ValueError names the text that is neither."""
    return np.array([BOOLS[t] for t in words(texts, BOOLS)], dtype=np.bool_)


def words(texts: Sequence[str], allowed: Sequence[str] | Mapping[str, Any]) -> Sequence[str]:
    """Return the texts if all are allowed; a ValueError names one that is not."""
    for text in set(texts):
        if text not in allowed:
            raise ValueError(f"holds {_shown(text)}; allowed: {', '.join(allowed)}")
    return texts


def _check(texts: Sequence[str], pattern: re.Pattern[str], what: str) -> None:
    if not all(map(pattern.fullmatch, texts)):
        wrong = next(text for text in texts if not pattern.fullmatch(text))
        raise ValueError(f"holds {_shown(wrong)}, which is not {what}")


def _shown(text: str) -> str:
    return repr(text if len(text) <= 30 else f"{text[:27]}...")


def statuses(texts: Sequence[str]) -> NDArray[np.str_]:
    """Parse how trials ended [n]; a ValueError names a text that is not a status."""
    return np.array(words(texts, STATUSES), dtype=np.str_)


def purposes(texts: Sequence[str]) -> NDArray[np.int64]:
    """Parse what evaluation episodes are for, as indices into ``PURPOSES`` [n]."""
    return np.array([PURPOSES.index(t) for t in words(texts, PURPOSES)], dtype=np.int64)


class Column(NamedTuple):
    """A column of a table.

    Attributes:
        read: texts [n] -> array [n]; raises a ValueError that says which text is invalid.
        write: a Python scalar -> its text; for a float, the shortest text that parses to it.
    """

    read: Parser
    write: Callable[[Any], str] = str


TRIAL_COLUMNS: dict[str, Column] = {
    "trial": Column(integers),
    "seed": Column(integers),
    "iterations": Column(integers),
    "converged": Column(booleans),
    "score": Column(numbers),
    "frames": Column(integers),
    "seconds": Column(numbers, "{:.6f}".format),
    "status": Column(statuses),
}
PASS_COLUMNS: dict[str, Column] = {
    "passed": Column(booleans),
    "iterations_to_pass": Column(integers),
    "frames_to_pass": Column(integers),
}
"""Further columns of ``trials.csv``; files of older versions have none."""
LEARN_COLUMNS: dict[str, Column] = {
    "learned": Column(booleans),
    "iterations_to_learn": Column(integers),
    "frames_to_learn": Column(integers),
    "learned_score": Column(numbers),
}
"""Further columns of ``trials.csv`` of a job that has evaluations."""
EPISODE_COLUMNS: dict[str, Column] = {
    "trial": Column(integers),
    "iteration": Column(integers),
    "score": Column(numbers),
    "frames": Column(integers),
}
EVALUATION_COLUMNS: dict[str, Column] = {
    "trial": Column(integers),
    "iteration": Column(integers),
    "score": Column(numbers),
}
PURPOSE_COLUMNS = {"purpose": Column(purposes, PURPOSES.__getitem__)}
"""A further column of ``evaluations.csv``: what the episode is for; files of older versions have
none, and only scheduled episodes."""
TIMING_COLUMNS = ("experiment", "job", "trial", "seconds", "frames")
CURVE_COLUMNS = {"iteration": Column(integers), "value": Column(numbers)}
"""The columns of a file in ``scalars/``, which has no header line."""


def table_text(columns: Mapping[str, Column], values: Mapping[str, NDArray[Any]]) -> str:
    """The text of a table, from the values of each column [rows].

    Example:
        >>> print(table_text({"trial": Column(integers)}, {"trial": np.arange(2)}), end="")
        trial
        0
        1
    """
    fields = (map(column.write, values[name].tolist()) for name, column in columns.items())
    return join_rows(columns, map(",".join, zip(*fields, strict=True)))


def join_rows(names: Iterable[str], rows: Iterable[str]) -> str:
    """The text of a table, from the texts of its rows."""
    return "\n".join([",".join(names), *rows]) + "\n"


def read_table(
    path: Path,
    columns: Mapping[str, Column],
    *groups: Mapping[str, Column],
    header: bool = True,
) -> dict[str, NDArray[Any]]:
    """Read the given columns of a table; the others are ignored.

    Args:
        path: the file.
        columns: by name.
        groups: further columns; of each group, the file has all or none.
        header: whether the first line names the columns; if not, they are ``columns``, in order.

    Raises:
        ResultsError: if the file is missing, truncated or not a table with these columns.
    """
    rows = _fields(path)
    names = rows.pop(0) if header else list(columns)
    for number, fields in enumerate(rows, start=1 + header):
        if len(fields) != len(names):
            raise ResultsError(f"{path}: line {number} has {len(fields)} fields, not {len(names)}")
    for group in groups:
        if any(name in names for name in group):
            columns = {**columns, **group}
    check_present(path, columns, names)
    twice = [name for name in columns if names.count(name) > 1]
    if twice:
        raise ResultsError(f"{path}: duplicate column {twice[0]}")
    texts = dict(zip(names, zip(*rows, strict=True), strict=True)) if rows else {}
    found = {}
    for name, column in columns.items():
        try:
            found[name] = column.read(texts.get(name, ()))
        except ValueError as error:
            raise ResultsError(f"{path}: column {name} {error}") from None
    return found


def check_present(path: Path, columns: Iterable[str], names: Container[str]) -> None:
    """Raise a ``ResultsError`` if a table with these names lacks some of the columns."""
    if missing := [name for name in columns if name not in names]:
        raise ResultsError(f"{path}: missing column: {', '.join(missing)}")


def _fields(path: Path) -> list[list[str]]:
    """The fields of every line."""
    try:
        text = read_file(path).decode()
    except FileNotFoundError:
        raise ResultsError(f"{path}: missing") from None
    except OSError as error:
        raise ResultsError(f"{path}: not readable ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ResultsError(f"{path}: not readable as CSV (not UTF-8)") from None
    if not text.endswith("\n"):
        raise ResultsError(f"{path}: truncated: the last line has no newline")
    return [line.removesuffix("\r").split(",") for line in text[:-1].split("\n")]
