"""Write the files of a job, each atomically and ``run.json`` last."""

from __future__ import annotations

import json
import os
import platform
import shutil
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trl_explore import __version__
from trl_explore.jobs.code import code_digests
from trl_explore.jobs.columns import (
    EPISODE_COLUMNS,
    EPISODES,
    EVALUATION_COLUMNS,
    EVALUATIONS,
    FILES,
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

    from trl_explore.training.trials import Trials


def clear(job: Path) -> None:
    """Remove the results of a job, finished or unfinished, from its folder; ``run.json`` first."""
    for name in (RUN, *FILES):
        (job / name).unlink(missing_ok=True)
    for temporary in job.glob(".*.tmp"):
        if temporary.is_dir():
            shutil.rmtree(temporary)
        else:
            temporary.unlink()
    if (job / SCALARS).exists():
        shutil.rmtree(job / SCALARS)


@cache
def versions() -> Mapping[str, str]:
    """The versions of Python and of the packages on which the bits of a result may depend."""
    own = {"python": platform.python_version(), "trl_explore": __version__}
    return own | {package: version(package) for package in PACKAGES if package not in own}


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
        kept: the arrays of ``kept_weights.safetensors``; this and the next are None if unknown.
        evaluations: the columns of ``evaluations.csv``.
        learned: the columns ``LEARN_COLUMNS`` of ``trials.csv``.
        diagnostics: further columns of ``episodes.csv``, one entry per iteration and active trial.
        visits: the arrays of ``visits.safetensors``.
    """
    import torch
    from safetensors.numpy import save
    from safetensors.torch import save as save_torch

    write_whole(job / TRIALS, _trials_csv(trials, config, learned or {}).encode())
    if episodes:
        extra = diagnostics or {}
        write_whole(job / EPISODES, _episodes_csv(trials, config["first_trial"], extra).encode())
    if evaluations is not None:
        values = _from(config["first_trial"], evaluations)
        text = table_text(EVALUATION_COLUMNS | PURPOSE_COLUMNS, values)
        write_whole(job / EVALUATIONS, text.encode())
    _write_scalars(job, trials)
    write_whole(job / WEIGHTS, save_torch({k: w.detach().contiguous() for k, w in weights.items()}))
    for name, arrays in ((KEPT, kept), (VISITS, visits)):
        if arrays is not None:
            write_whole(job / name, save({key: a.copy() for key, a in arrays.items()}))
    paths = [*(job / name for name in FILES), *sorted((job / SCALARS).glob("*.csv"))]
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
        "files": record(job, paths),
        "config": config,
        "versions": versions(),
        "code": code_digests(config),
        "machine": {"system": platform.system(), "processor": platform.machine()},
    }
    _sync(job)
    write_whole(job / RUN, (json.dumps(run, indent=2) + "\n").encode())


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
    files: dict[str, Any] = {}
    try:
        logger = CSVLogger(exp_name="curves", log_dir=str(parent))
        files = logger.experiment.files
        for name, curve in trials.curves().items():
            (_, first), *others = enumerate(curve.tolist(), start=1)
            logger.log_scalar(name, first, step=1)
            # The logger flushes after every value; its open file takes the others at once.
            with list(files.values())[-1] as file:
                file.writelines(f"{step},{value}\n" for step, value in others)
        for file in (parent / "curves" / "scalars").iterdir():
            _sync(file)
        (parent / "curves" / "scalars").replace(job / SCALARS)
    except OSError as error:
        for file in files.values():
            with suppress(OSError):  # it fails again; the logger's destructor would print that
                file.close()
        raise named(error, job / SCALARS) from None
    finally:
        shutil.rmtree(parent, ignore_errors=True)


def write_timings(sweep: Path, timings: pd.DataFrame) -> None:
    """Write the seconds of trials that were run alone.

    Args:
        sweep: the folder that holds the folders of the jobs.
        timings: the columns ``TIMING_COLUMNS``, one row per trial.
    """
    columns = timings[list(TIMING_COLUMNS)]
    table = columns.to_csv(index=False, lineterminator="\n", float_format="%.6f")
    write_whole(sweep / TIMINGS, table.encode())
