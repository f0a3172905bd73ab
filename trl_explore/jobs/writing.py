"""Writing the files of a job: each appears at once and whole, ``run.json`` last."""

from __future__ import annotations

import json
import os
import platform
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.jobs.columns import (
    EPISODE_COLUMNS,
    EPISODES,
    EVALUATION_COLUMNS,
    EVALUATIONS,
    PACKAGES,
    RUN,
    SCALARS,
    TIMING_COLUMNS,
    TIMINGS,
    TRIAL_COLUMNS,
    TRIALS,
    WEIGHTS,
)
from trl_explore.jobs.integrity import record

if TYPE_CHECKING:
    import pandas as pd
    from torch import Tensor

    from trl_explore.training.diagnostics import Diagnostics
    from trl_explore.training.evaluation import Evaluator
    from trl_explore.training.record import Trials


def clear(job: Path) -> None:
    """Remove the results of a job, finished or not, from its folder; ``run.json`` first."""
    for name in (RUN, TRIALS, EPISODES, EVALUATIONS, WEIGHTS):
        (job / name).unlink(missing_ok=True)
    for temporary in job.glob(".*.tmp"):
        if temporary.is_dir():
            shutil.rmtree(temporary)
        else:
            temporary.unlink()
    if (job / SCALARS).exists():
        shutil.rmtree(job / SCALARS)


def versions() -> dict[str, str]:
    """What the bits of a result may depend on: Python and the packages, with their versions."""
    return {"python": platform.python_version()} | {p: version(p) for p in PACKAGES}


def write_job(
    job: Path,
    trials: Trials,
    weights: Mapping[str, Tensor],
    *,
    config: Mapping[str, Any],
    experiment: str,
    strategy: str,
    collector: str,
    seconds: float,
    episodes: bool = True,
    evaluator: Evaluator | None = None,
    diagnostics: Diagnostics | None = None,
) -> None:
    """Write every file of a finished job.

    Args:
        job: the folder, which exists and holds no results.
        trials: the record of the trials, all of them stopped.
        weights: name -> parameter [trials, ...].
        config: the resolved configuration.
        experiment: name of the sweep.
        strategy: name of the strategy.
        collector: name of the collector that was used.
        seconds: wall time of the training, without compilation.
        episodes: whether to write ``episodes.csv``.
        evaluator: what was evaluated, for ``evaluations.csv``.
        diagnostics: what was recorded beside the scores, for further columns of ``episodes.csv``.
    """
    import torch

    _write_text(job / TRIALS, _trials_csv(trials, config))
    if episodes:
        extra = {} if diagnostics is None else diagnostics.columns()
        _write_text(job / EPISODES, _episodes_csv(trials, config["first_trial"], extra))
    if evaluator is not None:
        _write_text(job / EVALUATIONS, _evaluations_csv(evaluator.rows(), config["first_trial"]))
    _write_scalars(job, trials)
    _write_weights(job / WEIGHTS, weights)
    run = {
        "status": "finished",
        "experiment": experiment,
        "strategy": strategy,
        "seed": config["seed"],
        "trials": len(trials),
        "collector": collector,
        "seconds": seconds,
        "iterations": trials.iteration,
        "threads": {"compiled": config.get("threads", 1), "torch": torch.get_num_threads()},
        "files": record(job),
        "config": config,
        "versions": versions(),
        "machine": {"system": platform.system(), "processor": platform.machine()},
    }
    _sync(job)
    _write_text(job / RUN, json.dumps(run, indent=2) + "\n")


def _write_text(path: Path, text: str) -> None:
    _write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _write_whole(path: Path, write: Callable[[Path], Any]) -> None:
    """Let ``write`` fill a temporary file beside ``path``, and move it there when it is whole."""
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        write(temporary)
        _sync(temporary)
        temporary.replace(path)
    except OSError as error:
        raise _of(path, error) from None
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _of(path: Path, error: OSError) -> OSError:
    """The error with the name of the file: a full disk does not say what it has no room for."""
    return error if error.errno is None else OSError(error.errno, error.strerror, str(path))


def _sync(path: Path) -> None:
    """Wait until the disk has the contents: a rename must not outlive a loss of power alone."""
    place = os.open(path, os.O_RDONLY)
    try:
        os.fsync(place)
    finally:
        os.close(place)


def _number(value: float) -> str:
    """The shortest text that reads back as the same float64."""
    return repr(float(value))


def _trials_csv(trials: Trials, config: Mapping[str, Any]) -> str:
    lines = [",".join(TRIAL_COLUMNS)]
    converged, status = trials.converged, trials.status
    for k in range(len(trials)):
        row = (
            config["first_trial"] + k,
            config["seed"],
            trials.iterations[k],
            converged[k],
            _number(trials.score[k]),
            trials.frames[k],
            f"{trials.seconds[k]:.6f}",
            status[k],
        )
        lines.append(",".join(map(str, row)))
    return "\n".join(lines) + "\n"


def _episodes_csv(
    trials: Trials, first_trial: int, extra: Mapping[str, NDArray[np.float32]]
) -> str:
    columns = trials.episodes()
    columns["trial"] = columns["trial"] + first_trial
    rows = zip(*(columns[name].tolist() for name in EPISODE_COLUMNS), strict=True)
    lines = [f"{trial},{iteration},{score},{frames}" for trial, iteration, score, frames in rows]
    if extra:
        # The quantities of an iteration stand beside each of its episodes.
        repeats = len(lines) // len(next(iter(extra.values())))
        texts = zip(*([str(x) for x in np.repeat(c, repeats)] for c in extra.values()), strict=True)
        lines = [",".join([line, *more]) for line, more in zip(lines, texts, strict=True)]
    return "\n".join([",".join([*EPISODE_COLUMNS, *extra]), *lines]) + "\n"


def _evaluations_csv(columns: Mapping[str, NDArray[Any]], first_trial: int) -> str:
    trial = (columns["trial"] + first_trial).tolist()
    rows = zip(trial, columns["iteration"].tolist(), columns["score"].tolist(), strict=True)
    lines = [f"{trial},{iteration},{score}" for trial, iteration, score in rows]
    return "\n".join([",".join(EVALUATION_COLUMNS), *lines]) + "\n"


def _write_scalars(job: Path, trials: Trials) -> None:
    from torchrl.record import CSVLogger

    parent = job / ".scalars.tmp"
    shutil.rmtree(parent, ignore_errors=True)  # the logger appends to what it finds
    try:
        logger = CSVLogger(exp_name="curves", log_dir=str(parent))
        for name, curve in trials.curves().items():
            for step, value in enumerate(curve.tolist(), start=1):
                logger.log_scalar(name, value, step=step)
        for file in (parent / "curves" / "scalars").iterdir():
            _sync(file)
        (parent / "curves" / "scalars").replace(job / SCALARS)
    except OSError as error:
        raise _of(job / SCALARS, error) from None
    finally:
        shutil.rmtree(parent, ignore_errors=True)


def _write_weights(path: Path, weights: Mapping[str, Tensor]) -> None:
    from safetensors.torch import save

    tensors = {name: tensor.detach().contiguous() for name, tensor in weights.items()}
    _write_whole(path, lambda temporary: temporary.write_bytes(save(tensors)))


def write_timings(sweep: Path, timings: pd.DataFrame) -> None:
    """Write the seconds of trials that were run by themselves.

    Args:
        sweep: the folder that holds the folders of the jobs.
        timings: the columns ``TIMING_COLUMNS``, one row per trial.
    """
    table = timings[list(TIMING_COLUMNS)].to_csv(
        index=False, lineterminator="\n", float_format="%.6f"
    )
    _write_text(sweep / TIMINGS, table)
