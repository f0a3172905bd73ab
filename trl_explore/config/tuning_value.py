"""The number that a job returns to a sweeper that optimises, such as Optuna's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from trl_explore.jobs.reading import read_job
from trl_explore.statistics.outcomes import Outcomes, judged
from trl_explore.statistics.samples import score_range

LONGEST, LOWEST = 1e9, -1e6
"""The objectives of a job without a result, if neither a cap nor a range of scores is known."""


def is_wanted() -> bool:
    """Whether the sweeper of the running job optimises a number."""
    return "direction" in (HydraConfig.get().sweeper or ())


def returned(config: DictConfig, folder: Path | None) -> float | list[float] | None:
    """The objective of the running job, or None if its sweeper does not optimise.

    Args:
        config: the configuration of the job.
        folder: of the finished job; None: it failed, so its objective is the worst.
    """
    if not is_wanted():
        return None
    sweeper: Any = HydraConfig.get().sweeper
    several = not isinstance(sweeper.direction, str) and isinstance(sweeper.direction, Sequence)
    outcomes = None if folder is None else read_job(folder)
    values = [
        worst(config, _name(direction))
        if outcomes is None
        else objective(outcomes, _name(direction))
        for direction in (sweeper.direction if several else [sweeper.direction])
    ]
    return values if several else values[0]


def best(sweep: Path) -> str:
    """What Optuna found, one line; empty without its file in the folder of the sweep."""
    file = sweep / "optimization_results.yaml"
    if not file.is_file():
        return ""
    found: Any = OmegaConf.to_container(OmegaConf.load(file))
    solutions = found.get("solutions") or [
        {"params": found.get("best_params"), "values": [found.get("best_value")]}
    ]
    texts = [
        f"{' '.join(f'{key}={value}' for key, value in solution['params'].items())}"
        f" ({', '.join(f'{value:g}' for value in solution['values'])})"
        for solution in solutions
    ]
    return f"best: {'; '.join(texts)}"


def objective(outcomes: Outcomes, direction: str) -> float:
    """The mean over the trials of a job, which is finite.

    ``minimize``: E[min(T, cap)], the restricted mean of the iterations until a trial converged by
    the rule that stops it (until it had learned, with ``stop_on=never`` and evaluations).
    ``maximize``: the learned score; without evaluations, the final score. A trial that diverged
    counts as the cap, or as the lowest score of the environment (-1e6 if that is unknown).
    """
    if direction == "minimize":
        outcomes = measured(outcomes)
        return float(np.where(outcomes.converged, outcomes.iterations, outcomes.cap).mean())
    scores = outcomes.score if outcomes.learned_score is None else outcomes.learned_score
    diverged = outcomes.status == "diverged"
    return float(np.where(diverged, _lowest(outcomes.config.get("env")), scores).mean())


def measured(outcomes: Outcomes) -> Outcomes:
    """The outcomes, judged by the event whose time is minimised."""
    if outcomes.config.get("stop_on") in ("learned", "both", "never"):
        return judged(outcomes, "passed" if outcomes.learned is None else "learned")
    return outcomes


def worst(config: DictConfig, direction: str) -> float:
    """The objective of a job that failed."""
    if direction == "maximize":
        return _lowest(config.get("env"))
    cap = config.get("max_iterations")
    return float(cap) if isinstance(cap, int) and not isinstance(cap, bool) else LONGEST


def _lowest(env: Any) -> float:
    lowest = score_range(env)[0]
    return lowest if np.isfinite(lowest) else LOWEST


def _name(direction: Any) -> str:
    return str(getattr(direction, "name", direction)).rpartition(".")[2]
