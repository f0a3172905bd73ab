"""Long CSV files: one row for each point of a run, with columns that say whose it is.

Which column is what is given (``--column score=ep_rew``), or follows from the usual names.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from trl_explore.jobs.columns import ResultsError
from trl_explore.logs.log import Log, column_points, files_below, place_of, read_csv

USUAL = {
    "step": (
        "step", "steps", "global_step", "timestep", "timesteps", "total_timesteps", "env_steps",
        "frame", "frames", "iteration", "episode", "epoch",
    ),
    "score": (
        "score", "return", "episode_return", "episodic_return", "ep_rew_mean", "ep_rew",
        "episode_reward", "reward",
    ),
    "seed": ("seed", "random_seed"),
    "configuration": (
        "configuration", "config", "algorithm", "algo", "agent", "method", "exp_name", "model",
    ),
    "environment": ("environment", "env", "env_id", "env_name", "task"),
    "run": ("run", "run_id", "trial"),
}  # fmt: skip
"""What a column can be -> its usual names."""


def read(folder: Path, columns: Mapping[str, str] | None = None) -> Iterator[Log]:
    """The runs of the files at or below a folder, or of one file.

    Args:
        folder: a folder or a file.
        columns: what a column is -> its name; several names for a configuration, with commas.

    Raises:
        ResultsError: a named column is missing, or there is none of steps or scores.
    """
    for file in files_below(folder, ["*.csv"]):
        frame = read_csv(file)
        roles = _roles(file, [str(name) for name in frame.columns], columns or {})
        step, score = roles.pop("step")[0], roles.pop("score")[0]
        keys = [name for names in roles.values() for name in names]
        groups: Any = frame.groupby(keys, sort=False, dropna=False) if keys else [((), frame)]
        for values, rows in groups:
            of = dict(zip(keys, map(_text, values), strict=True))
            facts = {
                role: of[names[0]] if len(names) == 1 else ", ".join(f"{n}={of[n]}" for n in names)
                for role, names in roles.items()
            }
            words = [place_of(file, folder.parent if folder.is_file() else folder), *of.values()]
            yield Log(
                " ".join(words),
                [score],
                lambda name, rows=rows, step=step: column_points(rows, step, name),
                step,
                facts={"configuration": file.stem} | facts,
            )


def _roles(file: Path, names: list[str], given: Mapping[str, str]) -> dict[str, list[str]]:
    """What each used column is -> its names."""
    lower = {name.lower().strip(): name for name in reversed(names)}
    roles: dict[str, list[str]] = {}
    for role, usual in USUAL.items():
        wanted = [part.strip() for part in given[role].split(",")] if role in given else []
        if missing := [name for name in wanted if name not in names]:
            raise ResultsError(f"{file}: no column {missing[0]!r}; it has {', '.join(names)}")
        taken = {name for found in roles.values() for name in found}
        found = wanted or [lower[u] for u in usual if u in lower and lower[u] not in taken][:1]
        if found:
            roles[role] = found
        elif role in ("step", "score"):
            raise ResultsError(
                f"{file}: which column is the {role}? --column {role}=NAME; it has"
                f" {', '.join(names)}"
            )
    return roles


def _text(value: object) -> str:
    if isinstance(value, float | np.floating):
        return "none" if pd.isna(value) else f"{value:g}"
    return str(value)
