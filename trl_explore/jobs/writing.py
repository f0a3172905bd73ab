"""Write the files of a job, each atomically and ``run.json`` last."""

from __future__ import annotations

import json
import os
import platform
import shutil
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.jobs.code import code_digests
from trl_explore.jobs.columns import (
    EPISODE_COLUMNS,
    EPISODES,
    EVALUATION_COLUMNS,
    EVALUATIONS,
    KEPT,
    LEARN_COLUMNS,
    PACKAGES,
    PASS_COLUMNS,
    PURPOSE_COLUMNS,
    SCALARS,
    TIMING_COLUMNS,
    TIMINGS,
    TRIAL_COLUMNS,
    TRIALS,
    VISITS,
    WEIGHTS,
    join_rows,
    table_text,
)
from trl_explore.jobs.files import RUN, named, record, write_whole

if TYPE_CHECKING:
    import pandas as pd
    from torch import Tensor

    from trl_explore.training.record import Trials


def clear(job: Path) -> None:
    """Remove the results of a job, finished or unfinished, from its folder; ``run.json`` first."""
    for name in (RUN, TRIALS, EPISODES, EVALUATIONS, WEIGHTS, KEPT, VISITS):
        (job / name).unlink(missing_ok=True)
    for temporary in job.glob(".*.tmp"):
        if temporary.is_dir():
            shutil.rmtree(temporary)
        else:
            temporary.unlink()
    if (job / SCALARS).exists():
        shutil.rmtree(job / SCALARS)


def versions() -> dict[str, str]:
    """The versions of Python and of the packages on which the bits of a result may depend."""
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
    kept: Mapping[str, NDArray[Any]] | None = None,
    evaluations: Mapping[str, NDArray[Any]] | None = None,
    learned: Mapping[str, NDArray[Any]] | None = None,
    diagnostics: Mapping[str, NDArray[Any]] | None = None,
    visits: Mapping[str, NDArray[Any]] | None = None,
) -> None:
    """Write every file of a finished job.

    Args:
        job: the folder, which must exist and hold no results.
        trials: the record of the trials, all stopped.
        weights: name -> parameter [trials, ...].
        config: the resolved configuration.
        experiment: name of the experiment.
        strategy: name of the strategy.
        collector: name of the collector that was used.
        seconds: wall time of the training, without compilation.
        episodes: whether to write ``episodes.csv``.
        kept: the arrays of ``kept_weights.safetensors``; None: do not write it.
        evaluations: the columns of ``evaluations.csv``; None: do not write it.
        learned: the columns ``LEARN_COLUMNS`` of ``trials.csv``; None: do not write them.
        diagnostics: further columns of ``episodes.csv``, one entry per iteration and active trial.
        visits: the arrays of ``visits.safetensors``; None: do not write it.
    """
    import torch
    from safetensors.numpy import save

    _write_text(job / TRIALS, _trials_csv(trials, config, learned or {}))
    if episodes:
        extra = diagnostics or {}
        _write_text(job / EPISODES, _episodes_csv(trials, config["first_trial"], extra))
    if evaluations is not None:
        values = _from(config["first_trial"], evaluations)
        _write_text(job / EVALUATIONS, table_text(EVALUATION_COLUMNS | PURPOSE_COLUMNS, values))
    _write_scalars(job, trials)
    _write_weights(job / WEIGHTS, weights)
    for name, arrays in ((KEPT, kept), (VISITS, visits)):
        if arrays is not None:
            write_whole(job / name, save({key: a.copy() for key, a in arrays.items()}))
    paths = [job / name for name in (TRIALS, EPISODES, EVALUATIONS, WEIGHTS, KEPT, VISITS)]
    run = {
        "status": "finished",
        "experiment": experiment,
        "strategy": strategy,
        "seed": config["seed"],
        "trials": len(trials),
        "collector": collector,
        "seconds": seconds,
        "iterations": trials.iteration,
        "threads": {"compiled": config["threads"], "torch": torch.get_num_threads()},
        "files": record(job, [*paths, *sorted((job / SCALARS).glob("*.csv"))]),
        "config": config,
        "versions": versions(),
        "code": code_digests(config),
        "machine": {"system": platform.system(), "processor": platform.machine()},
    }
    _sync(job)
    _write_text(job / RUN, json.dumps(run, indent=2) + "\n")


def _write_text(path: Path, text: str) -> None:
    write_whole(path, text.encode())


def _sync(path: Path) -> None:
    """Flush the contents to disk: after a power failure, a rename must not survive without them."""
    place = os.open(path, os.O_RDONLY)
    try:
        os.fsync(place)
    finally:
        os.close(place)


def _trials_csv(
    trials: Trials, config: Mapping[str, Any], learned: Mapping[str, NDArray[Any]]
) -> str:
    values = {
        "trial": config["first_trial"] + np.arange(len(trials)),
        "seed": np.full(len(trials), config["seed"]),
        **learned,
    }
    columns = TRIAL_COLUMNS | PASS_COLUMNS | (LEARN_COLUMNS if learned else {})
    others = {name: getattr(trials, name) for name in columns if name not in values}
    return table_text(columns, {name: np.asarray(x) for name, x in (values | others).items()})


def _episodes_csv(
    trials: Trials, first_trial: int, extra: Mapping[str, NDArray[np.float32]]
) -> str:
    values = _from(first_trial, trials.episodes())
    if not extra:
        return table_text(EPISODE_COLUMNS, values)
    # The diagnostics of an iteration are repeated for each of its episodes, in single precision.
    repeats = len(values["trial"]) // len(next(iter(extra.values())))
    own = (map(column.write, values[name].tolist()) for name, column in EPISODE_COLUMNS.items())
    more = (map(str, np.repeat(column, repeats)) for column in extra.values())
    rows = map(",".join, zip(*own, *more, strict=True))
    return join_rows([*EPISODE_COLUMNS, *extra], rows)


def _from(first_trial: int, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The columns, with trial numbers that start at the job's first trial."""
    return {**columns, "trial": columns["trial"] + first_trial}


def _write_scalars(job: Path, trials: Trials) -> None:
    from torchrl.record import CSVLogger

    parent = job / ".scalars.tmp"
    shutil.rmtree(parent, ignore_errors=True)  # the logger appends to existing files
    try:
        logger = CSVLogger(exp_name="curves", log_dir=str(parent))
        for name, curve in trials.curves().items():
            for step, value in enumerate(curve.tolist(), start=1):
                logger.log_scalar(name, value, step=step)
        for file in (parent / "curves" / "scalars").iterdir():
            _sync(file)
        (parent / "curves" / "scalars").replace(job / SCALARS)
    except OSError as error:
        raise named(error, job / SCALARS) from None
    finally:
        shutil.rmtree(parent, ignore_errors=True)


def _write_weights(path: Path, weights: Mapping[str, Tensor]) -> None:
    from safetensors.torch import save

    tensors = {name: tensor.detach().contiguous() for name, tensor in weights.items()}
    write_whole(path, save(tensors))


def write_timings(sweep: Path, timings: pd.DataFrame) -> None:
    """Write the seconds of trials that were run alone.

    Args:
        sweep: the folder that holds the folders of the jobs.
        timings: the columns ``TIMING_COLUMNS``, one row per trial.
    """
    table = timings[list(TIMING_COLUMNS)].to_csv(
        index=False, lineterminator="\n", float_format="%.6f"
    )
    _write_text(sweep / TIMINGS, table)
