"""Stable-Baselines3: ``monitor.csv``, one row for each episode; or ``progress.csv``.

A file ``N.monitor.csv`` is environment N of the run of its folder (``make_vec_env(monitor_dir=)``),
``NAME.monitor.csv`` is a run of its own. The episodes of several environments are merged in the
order in which they ended; a step is a step of any of them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from trl_explore.logs.log import Log, by_folder, files_below, numbers, place_of, progress, read_csv

SCORES = ("episode return", "rollout/ep_rew_mean", "eval/mean_reward")
COLUMNS = ["r", "l", "t"]


def read(folder: Path) -> Iterator[Log]:
    """The runs at or below a folder."""
    found = files_below(folder, ["*monitor.csv"])
    for place, files in by_folder(found):
        for name, members in _runs(files).items():
            yield _run(place / name, folder, members)
    if not found:
        for file in files_below(folder, ["progress.csv"]):
            if log := progress(file, folder, ["time/total_timesteps"]):
                yield log


def _runs(files: list[Path]) -> dict[str, list[Path]]:
    """The files of each run of a folder, by the name of the run; empty for that of the folder."""
    runs: dict[str, list[Path]] = {}
    for file in files:
        stem = file.name.removesuffix("monitor.csv").rstrip("._-")
        run, _, last = stem.rpartition(".")
        runs.setdefault(run if last.isdigit() else stem, []).append(file)
    return runs


def _run(path: Path, folder: Path, files: list[Path]) -> Log:
    parts, environments, notes, starts = [], set(), [], []
    for file in files:
        header, frame, restarts = _monitor(file)
        environments.add(str(header.get("env_id") or ""))
        starts.append(float(header.get("t_start") or 0.0))
        parts.append(frame.assign(t=frame["t"] + starts[-1]))
        if restarts:
            notes.append("continued in one file")
        if frame.empty:
            notes.append(f"no episodes in {file.name}")
    frame = pd.concat(parts).sort_values("t", kind="stable")
    if len(files) > 1:
        notes.append(f"{len(files)} environments")
    step = np.cumsum(frame["l"].to_numpy(dtype=np.float64))
    score = frame["r"].to_numpy(dtype=np.float64)
    names = environments - {"", "None"}
    return Log(
        place_of(path, folder),
        ["episode return"],
        lambda name: (step, score),
        episodes=frozenset(["episode return"]),
        facts={"environment": names.pop()} if len(names) == 1 else {},
        notes=notes,
        started=min(starts),
    )


def _monitor(file: Path) -> tuple[dict[str, Any], Any, bool]:
    """The header, the episodes with their time in seconds, and whether the clock began again."""
    with file.open(encoding="utf-8", errors="replace") as lines:
        first, second = lines.readline(), lines.readline()
    header: dict[str, Any] = {}
    with suppress(ValueError):
        header = json.loads(first[1:]) if first.startswith("#") else {}
    titled = "r,l,t" in (first[:5], second[:5])
    frame = read_csv(file, skip=int(first.startswith("#")), header=titled)
    if len(frame.columns) < len(COLUMNS):
        frame = pd.DataFrame(columns=COLUMNS)
    columns = (numbers(frame[name]) for name in frame.columns)
    frame = pd.DataFrame(dict(zip(COLUMNS, columns, strict=False)))
    frame = frame[np.isfinite(frame["l"]) & np.isfinite(frame["t"])]
    seconds, restarts = _onward(np.asarray(frame["t"], dtype=np.float64))
    return header, frame.assign(t=seconds), restarts


def _onward(t: NDArray[np.float64]) -> tuple[NDArray[np.float64], bool]:
    """Seconds that never go back: after a restart, the clock goes on from its last value."""
    back = np.diff(t, prepend=t[:1]) < 0
    lost = np.where(back, np.roll(t, 1), 0.0)
    return t + np.cumsum(lost), bool(back.any())
