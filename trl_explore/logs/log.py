"""A run as its files hold it, its curve of scores, and what all readers share."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from trl_explore.checks import first_line
from trl_explore.jobs.files import ResultsError

Points = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Steps and values [n], in the order of the file."""


@dataclass(frozen=True, eq=False)
class Log:
    """Everything that one run logged.

    Attributes:
        place: the path of the run, from the given folder on.
        names: the quantities that were logged.
        load: the points of a quantity.
        step: what the steps count, as the program names it.
        episodes: quantities with one value for each episode, not a mean over several.
        facts: ``seed``, ``environment`` and ``configuration``, where the files say them;
            ``overrides`` are parts of a configuration, with commas.
        notes: what was unusual, one phrase each.
        started: when the run began, to tell a repetition from its original; any unit.
    """

    place: str
    names: Sequence[str]
    load: Callable[[str], Points]
    step: str = "step"
    episodes: frozenset[str] = frozenset()
    facts: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    started: float = 0.0


@dataclass(frozen=True, eq=False)
class Curve:
    """The scores of one run [n], all finite, by its steps, which do not decrease.

    ``notes`` say what was left out or changed; ``ended_nan``: whether the values after the last one
    were not finite.
    """

    step: NDArray[np.float64]
    score: NDArray[np.float64]
    notes: tuple[str, ...] = ()
    ended_nan: bool = False

    def __len__(self) -> int:
        return len(self.step)

    @property
    def last(self) -> float:
        """The last step; 0 without points."""
        return float(self.step[-1]) if len(self) else 0.0

    def smoothed(self, window: int) -> Curve:
        """The mean of the last ``window`` scores, at every step from the first full window on."""
        if window == 1 or len(self) < window:
            return self if window == 1 else Curve(self.step[:0], self.score[:0])
        total = np.cumsum(np.concatenate([[0.0], self.score]))
        return Curve(self.step[window - 1 :], (total[window:] - total[:-window]) / window)

    def at(self, grid: NDArray[np.float64]) -> NDArray[np.float64]:
        """The values at steps [m], linear between points; at both ends the nearest point's."""
        if not len(self):
            return np.full(len(grid), np.nan)
        # Of points at one step, the last counts.
        last = np.append(np.diff(self.step) > 0, True)
        return np.interp(grid, self.step[last], self.score[last])


def clean(
    step: NDArray[np.float64], score: NDArray[np.float64], *, episodes: bool = False
) -> Curve:
    """The curve of the points of a file, in the order of the file.

    Where steps go back, the run was continued from an earlier state: later values replace those
    of the steps that it repeats. Of equal steps the last value counts, except of ``episodes``,
    because several can end at once. Points that are not finite are left out.

    >>> curve = clean(np.array([1.0, 2, 3, 2, 3]), np.array([5.0, 6, 7, 8, 9]))
    >>> curve.score.tolist(), curve.notes
    ([5.0, 8.0, 9.0], ('restarted 1 time, 2 points replaced',))
    """
    notes = []
    placed = np.isfinite(step)
    step, score = step[placed], score[placed]
    finite = np.isfinite(score)
    ended_nan = len(finite) > 0 and not bool(finite[-1])
    back = np.diff(step, prepend=-np.inf) < 0
    if restarts := int(back.sum()):
        begins = np.full(len(step) + 1, np.inf)
        begins[:-1][back] = step[back]
        keep = step < np.minimum.accumulate(begins[::-1])[::-1][1:]
        notes.append(
            f"restarted {_count(restarts, 'time')}, {_count(int((~keep).sum()), 'point')} replaced"
        )
        step, score, finite = step[keep], score[keep], finite[keep]
    if bad := int((~finite).sum()):
        notes.append(f"{_count(bad, 'value')} not finite, left out")
        step, score = step[finite], score[finite]
    if not episodes:
        last = np.append(np.diff(step) > 0, True) if len(step) else np.zeros(0, bool)
        if twice := int((~last).sum()):
            notes.append(f"{_count(twice, 'duplicate step')}, the last value counts")
        step, score = step[last], score[last]
    return Curve(step, score, tuple(notes), ended_nan)


def _count(n: int, word: str) -> str:
    return f"{n:,} {word}{'s' * (n != 1)}"


def place_of(path: Path, folder: Path) -> str:
    """The path of a run from a given folder on, its name included.

    >>> place_of(Path("logs/ppo/0"), Path("logs"))
    'logs/ppo/0'
    """
    folder = folder.resolve()
    return (Path(folder.name) / path.resolve().relative_to(folder)).as_posix()


def hydra_facts(path: Path, folder: Path) -> dict[str, str]:
    """What Hydra recorded about the run of a file: the overrides of the job, and its seed.

    ``.hydra`` is looked for in the folder of the file and above it, up to the given folder.
    """
    for place in [path, *path.parents]:
        if (place / ".hydra" / "overrides.yaml").is_file():
            lines = [
                (place / ".hydra" / f"{name}.yaml").read_text(encoding="utf-8", errors="replace")
                for name in ("overrides", "config")
                if (place / ".hydra" / f"{name}.yaml").is_file()
            ]
            words = re.findall(r"^- '?([^'\n]+=[^'\n]*)'?$", lines[0], re.M)
            words = [w for w in words if not w.startswith(("logger", "hydra", "device"))]
            facts = {"overrides": ",".join(words)} if words else {}
            for key, pattern in (("seed", r"seed: (\d+)"), ("environment", r"env_name: (\S+)")):
                if match := re.search(rf"^ *{pattern}$", lines[-1], re.M):
                    facts[key] = match[1]
            return facts
        if place == folder:
            break
    return {}


def files_below(folder: Path, patterns: Iterable[str]) -> list[Path]:
    """The files at or below a folder whose names match one of the patterns, sorted."""
    if folder.is_file():
        return [folder]
    return sorted({p for pattern in patterns for p in folder.rglob(pattern) if p.is_file()})


def by_folder(files: Iterable[Path]) -> Iterator[tuple[Path, list[Path]]]:
    """The files of each folder."""
    groups: dict[Path, list[Path]] = {}
    for file in files:
        groups.setdefault(file.parent, []).append(file)
    yield from groups.items()


def read_csv(path: Path, *, skip: int = 0, header: bool = True) -> Any:
    """A CSV file of any program as a data frame; empty if it has no lines.

    Fields are separated by what the first line has most of: commas, semicolons or tabs; with
    semicolons, a comma may be the decimal point. A line that was cut off, or that has too many
    fields, is left out. Only an empty field is missing; ``nan`` is a value.

    Raises:
        ResultsError: the file is not readable as CSV.
    """
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as lines:
            first = next(islice(lines, skip, None), "")
        separator = max(",;\t", key=first.count)
        return pd.read_csv(
            path, skiprows=skip, header=0 if header else None, on_bad_lines="skip", sep=separator,
            decimal="," if separator == ";" else ".", keep_default_na=False, na_values=[""],
            encoding="utf-8-sig", encoding_errors="replace", low_memory=False,
        )  # fmt: skip
    except pd.errors.EmptyDataError:
        return pd.DataFrame()
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path}: not readable as CSV ({first_line(error)})") from None


def numbers(column: Any) -> NDArray[np.float64]:
    """A column of a data frame as numbers [n]; what is not a number is NaN."""
    return np.asarray(pd.to_numeric(column, errors="coerce"), dtype=np.float64)


def column_points(frame: Any, step: str, name: str) -> Points:
    """The points of a column; a row in which the field is empty logs something else."""
    rows = frame[frame[name].notna()]
    return numbers(rows[step]), numbers(rows[name])


def progress(file: Path, folder: Path, steps: Sequence[str], **more: Any) -> Log | None:
    """The run of a CSV file with one row for each report, one column for each quantity.

    ``steps`` are possible names of the column of steps; None if there is none of them.
    """
    frame = read_csv(file)
    step = next((name for name in steps if name in frame.columns), None)
    if step is None:
        return None
    names = [str(n) for n in frame.columns if n != step and np.isfinite(numbers(frame[n])).any()]
    return Log(
        place_of(file.parent, folder),
        names,
        lambda name: column_points(frame, step, name),
        step,
        **more,
    )
