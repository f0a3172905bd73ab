"""The readers by name, and the runs of any number of folders, with the same quantity of each."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from trl_explore.jobs.files import ResultsError
from trl_explore.logs import csv_files as files
from trl_explore.logs import sb3, tensorboard
from trl_explore.logs.identify import identify, identify_by, labels
from trl_explore.logs.log import Curve, Log, clean


class Reader(NamedTuple):
    """A kind of files: how they are read, and the usual names of the score, the best first."""

    read: Callable[[Path], Iterator[Log]]
    scores: Sequence[str]
    files: str


READERS: Mapping[str, Reader] = {
    "sb3": Reader(sb3.read, sb3.SCORES, "monitor.csv or progress.csv"),
    "torchrl": Reader(files.read_torchrl, files.TORCHRL_SCORES, "scalars/*.csv of CSVLogger"),
    "cleanrl": Reader(tensorboard.read, tensorboard.SCORES, "event files of TensorBoard"),
    "tensorboard": Reader(tensorboard.read, tensorboard.SCORES, "event files of TensorBoard"),
    "wandb": Reader(files.read_wandb, files.WANDB_SCORES, "CSV files exported from a panel"),
    "rllib": Reader(files.read_rllib, files.RLLIB_SCORES, "progress.csv"),
    "csv": Reader(files.read_long, (), "CSV files with one row for each point"),
}


@dataclass(frozen=True, eq=False)
class Run:
    """The curve of one agent.

    Attributes:
        place: where it was read.
        environment: its name; empty if unknown.
        seed: None: unknown, so the run is not paired with others.
        score, step: names of the quantity, and of what a step is.
        episodes: whether each score is that of one episode.
        notes: what was unusual or changed.
        used: whether it is analysed; if not, the last note says why.
    """

    place: str
    configuration: str
    environment: str
    seed: int | None
    curve: Curve
    score: str
    step: str
    episodes: bool
    notes: tuple[str, ...]
    used: bool = True


def read_runs(
    kind: str,
    folders: Sequence[Path],
    *,
    columns: Mapping[str, str] | None = None,
    pattern: re.Pattern[str] | None = None,
) -> tuple[list[Run], list[str]]:
    """The runs of all folders, and the other quantities that all of them logged.

    Args:
        kind: a key of ``READERS``.
        folders: folders or files.
        columns: what a column is -> its name; ``score`` is possible for every kind.
        pattern: where a path has the configuration, the environment and the seed.

    Raises:
        ResultsError: nothing was found, or no quantity that all runs have; one line.
    """
    columns, reader = columns or {}, READERS[kind]
    if kind != "csv" and (unknown := sorted(set(columns) - {"score"})):
        raise ResultsError(f"--column {unknown[0]}=...: only score is possible with --from {kind}")
    read = partial(files.read_long, columns=columns) if kind == "csv" else reader.read
    logs: list[Log] = []
    for folder in folders:
        if not folder.exists():
            raise ResultsError(f"{folder}: no such file or folder")
        logs += read(folder)
    logs = [log for log in logs if log.names]
    if not logs:
        where = ", ".join(map(str, folders))
        raise ResultsError(f"no runs in {where}: --from {kind} reads {reader.files}")
    name, others = _quantity(logs, columns.get("score"), reader.scores)
    step = {log.step for log in logs}
    if len(step) > 1:
        raise ResultsError(f"the runs count different steps ({', '.join(sorted(step))})")
    found = [identify_by(pattern, log.place, log.facts) if pattern else
             identify(log.place, log.facts) for log in logs]  # fmt: skip
    runs = []
    for log, identity, label in zip(logs, found, labels(found), strict=True):
        episodes = name in log.episodes
        points = log.load(name) if name in log.names else (np.empty(0), np.empty(0))
        curve = clean(*points, episodes=episodes)
        notes, used = (*log.notes, *curve.notes), len(curve) > 0
        why = "no values" if name in log.names else f"did not log {name}"
        notes = notes if used else (*notes, f"{why}, left out")
        runs.append(
            Run(log.place, label, identity.environment, identity.seed, curve, name, log.step,
                episodes, notes, used)
        )  # fmt: skip
    return _latest(runs, [log.started for log in logs]), others


def _quantity(
    logs: Sequence[Log], wanted: str | None, usual: Iterable[str]
) -> tuple[str, list[str]]:
    """The quantity that is the score, and the others that all runs with it have.

    Less than half of the runs may lack it: those that ended before they logged any.
    """
    common = [name for name in logs[0].names if all(name in log.names for log in logs)]
    choice = [wanted] if wanted else list(usual)
    only = [] if wanted or len(common) > 1 else common
    for names, fewest in ((choice, len(logs)), (choice, len(logs) // 2 + 1), (only, len(logs))):
        for name in names:
            having = [log for log in logs if name in log.names]
            if len(having) >= fewest:
                shared = (n for n in having[0].names if all(n in log.names for log in having))
                return name, [other for other in shared if other != name]
    if wanted and any(wanted in log.names for log in logs):
        lacking = next(log.place for log in logs if wanted not in log.names)
        raise ResultsError(f"{lacking} did not log {wanted!r}, but other runs did")
    shown = ", ".join(common[:30]) or "nothing in common"
    what = f"no run logged {wanted!r}" if wanted else "which quantity is the score? --column"
    raise ResultsError(f"{what}{'' if wanted else ' score=NAME'}; the runs logged {shown}")


def _latest(runs: Sequence[Run], started: Sequence[float]) -> list[Run]:
    """The runs, of which a repetition of the same seed replaces the earlier one."""
    latest: dict[tuple[str, str, int], int] = {}
    for i in sorted(range(len(runs)), key=lambda i: (started[i], i)):
        if runs[i].used and (seed := runs[i].seed) is not None:
            latest[runs[i].environment, runs[i].configuration, seed] = i
    repeated = [r.used and r.seed is not None and i not in latest.values()
                for i, r in enumerate(runs)]  # fmt: skip
    why = "repeated later with the same seed, left out"
    return [
        replace(run, notes=(*run.notes, why), used=False) if again else run
        for run, again in zip(runs, repeated, strict=True)
    ]
