"""RLlib and Ray Tune: ``progress.csv`` of each trial, with its settings in ``params.json``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from trl_explore.logs.log import Log, files_below, progress

SCORES = (
    "env_runners/episode_return_mean", "episode_reward_mean",
    "sampler_results/episode_reward_mean", "evaluation/env_runners/episode_return_mean",
    "evaluation/episode_reward_mean",
)  # fmt: skip
STEPS = (
    "num_env_steps_sampled_lifetime", "env_runners/num_env_steps_sampled_lifetime",
    "num_env_steps_sampled", "timesteps_total", "training_iteration",
)  # fmt: skip


def read(folder: Path) -> Iterator[Log]:
    """The trials at or below a folder."""
    for file in files_below(folder, ["progress.csv"]):
        settings: dict[str, Any] = {}
        with suppress(OSError, ValueError):
            settings = dict(json.loads((file.parent / "params.json").read_text(encoding="utf-8")))
        named = {"seed": settings.get("seed"), "environment": settings.get("env")}
        facts = {key: str(value) for key, value in named.items() if value is not None}
        if log := progress(file, folder, STEPS, facts=facts, started=file.stat().st_mtime):
            yield log
