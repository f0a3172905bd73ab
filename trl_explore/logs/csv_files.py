"""CSV files: of TorchRL's ``CSVLogger``, RLlib and Ray Tune, Weights & Biases, and long ones."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from trl_explore.jobs.files import ResultsError
from trl_explore.logs.log import (
    Log,
    Points,
    column_points,
    files_below,
    hydra_facts,
    numbers,
    place_of,
    progress,
    read_csv,
)
from trl_explore.logs.tensorboard import EPISODES

TORCHRL_SCORES = (
    "train/reward", "train/episode_reward", "train/reward_episode", "reward_training", "r_training",
    "collection/reward", "eval/reward", "eval/episode_reward", "evaluation/reward", "r_evaluation",
    "score", "episode_reward", "reward",
)  # fmt: skip
STAMP = re.compile(r"_[0-9a-f]{8}_\d\d_\d\d_\d\d-\d\d_\d\d_\d\d$")
"""What ``generate_exp_name`` adds to a name."""


def read_torchrl(folder: Path) -> Iterator[Log]:
    """The runs at or below a folder: folders with a folder ``scalars``.

    Its files ``NAME.csv`` have lines of step and value, without a header.
    """
    for scalars in sorted({folder / "scalars", *folder.rglob("scalars")}):
        names = {
            file.relative_to(scalars).with_suffix("").as_posix(): file
            for file in files_below(scalars, ["*.csv"])
        }
        if names:
            place = STAMP.sub("", place_of(scalars.parent, folder))

            def load(name: str, files: dict[str, Path] = names) -> Points:
                frame = read_csv(files[name], header=False)
                return numbers(frame[0]), numbers(frame[1])

            started = max(file.stat().st_mtime for file in names.values())
            facts = hydra_facts(scalars.parent, folder)
            yield Log(place, list(names), load, facts=facts, started=started)


RLLIB_SCORES = (
    "env_runners/episode_return_mean", "episode_reward_mean",
    "sampler_results/episode_reward_mean", "evaluation/env_runners/episode_return_mean",
    "evaluation/episode_reward_mean",
)  # fmt: skip
RLLIB_STEPS = (
    "num_env_steps_sampled_lifetime", "env_runners/num_env_steps_sampled_lifetime",
    "num_env_steps_sampled", "timesteps_total", "training_iteration",
)  # fmt: skip


def read_rllib(folder: Path) -> Iterator[Log]:
    """The trials at or below a folder: ``progress.csv``, with the settings in ``params.json``."""
    for file in files_below(folder, ["progress.csv"]):
        settings: dict[str, Any] = {}
        with suppress(OSError, ValueError):
            settings = dict(json.loads((file.parent / "params.json").read_text(encoding="utf-8")))
        named = {"seed": settings.get("seed"), "environment": settings.get("env")}
        facts = {key: str(value) for key, value in named.items() if value is not None}
        if log := progress(file, folder, RLLIB_STEPS, facts=facts, started=file.stat().st_mtime):
            yield log


WANDB_SCORES = (
    "charts/episodic_return", "rollout/ep_rew_mean", "global_step/episodic_return",
    "episodic_return", "train/reward", "episode_reward", "score", "reward", "return",
)  # fmt: skip


def read_wandb(folder: Path) -> Iterator[Log]:
    """The runs of the exports of a panel at or below a folder, or of one file.

    The columns are ``Step`` (or ``global_step``), then ``RUN - QUANTITY`` with
    ``RUN - QUANTITY__MIN`` and ``__MAX``. In a row, the field of a run that logged nothing at this
    step is empty.

    Raises:
        ResultsError: a file has no column of a run.
    """
    for file in files_below(folder, ["*.csv"]):
        frame = read_csv(file)
        step, *columns = map(str, frame.columns)
        runs: dict[str, dict[str, str]] = {}
        for column in columns:
            run, dash, name = column.rpartition(" - ")
            if dash and not name.endswith(("__MIN", "__MAX")) and not name.startswith("_"):
                runs.setdefault(run, {})[name] = column
        if not runs:
            raise ResultsError(
                f"{file}: no column is named 'RUN - QUANTITY', as in a panel that W&B exports"
            )
        for run, names in runs.items():
            mean = any(
                f"{c}{end}" in columns and _differ(frame[c], frame[f"{c}{end}"])
                for c in names.values() for end in ("__MIN", "__MAX")
            )  # fmt: skip
            yield Log(
                run,
                list(names),
                lambda name, frame=frame, step=step, names=names: column_points(
                    frame, step, names[name]
                ),
                step,
                episodes=EPISODES,
                notes=["a mean of several values or runs: __MIN and __MAX differ"] if mean else (),
            )


def _differ(a: Any, b: Any) -> bool:
    x, y = numbers(a), numbers(b)
    known = np.isfinite(x) & np.isfinite(y)
    return not np.allclose(x[known], y[known], rtol=1e-6)


USUAL = {
    "step": (
        "step", "steps", "global_step", "timestep", "timesteps", "time_step", "time_steps",
        "total_timesteps", "num_timesteps", "total_steps", "env_steps", "num_env_steps",
        "environment_steps", "frame", "frames", "iteration", "episode", "epoch",
    ),
    "score": (
        "score", "return", "returns", "episode_return", "episodic_return", "mean_return",
        "average_return", "ep_rew_mean", "ep_rew", "episode_reward", "episode_reward_mean",
        "mean_reward", "reward_mean", "average_reward", "total_reward", "reward", "rewards",
    ),
    "seed": ("seed", "random_seed"),
    "configuration": (
        "configuration", "config", "algorithm", "algo", "agent", "method", "exp_name", "model",
    ),
    "environment": ("environment", "env", "env_id", "env_name", "task"),
    "run": ("run", "run_id", "trial"),
}  # fmt: skip
"""What a column can be -> its usual names, as :func:`_usual` writes them."""


def read_long(folder: Path, columns: Mapping[str, str] | None = None) -> Iterator[Log]:
    """The runs of long files, with one row for each point, at or below a folder or of one file.

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
            # Without a column of configurations, the path says which one it is.
            place = place_of(file.with_suffix(""), folder.parent if folder.is_file() else folder)
            yield Log(
                " ".join([place, *of.values()]) if "configuration" in facts else place,
                [score],
                lambda name, rows=rows, step=step: column_points(rows, step, name),
                step,
                facts=facts,
            )


def _roles(file: Path, names: list[str], given: Mapping[str, str]) -> dict[str, list[str]]:
    """What each used column is -> its names."""
    lower = {_usual(name): name for name in reversed(names)}
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


def _usual(name: str) -> str:
    """A name as the keys of ``USUAL`` are written.

    >>> _usual(" Total Timesteps"), _usual("rollout/ep_rew_mean")
    ('total_timesteps', 'ep_rew_mean')
    """
    return re.sub(r"[\s\-]+", "_", name.strip().lower().rsplit("/", 1)[-1])


def _text(value: object) -> str:
    if isinstance(value, float | np.floating):
        return "none" if pd.isna(value) else f"{value:g}"
    return str(value)
