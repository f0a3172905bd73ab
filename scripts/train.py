"""Train: ``python scripts/train.py [-m] [key=value ...]``; ``--help`` lists the keys."""

from __future__ import annotations

import logging
import os
import sys
import time
from pathlib import Path

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from trl_explore import config as configuration
from trl_explore.config import CONF, ConfigError
from trl_explore.results import ResultsError

finished: list[Path] = []
failed: list[str] = []


@hydra.main(version_base="1.3", config_path=str(CONF), config_name="train")
def run(config: DictConfig) -> None:
    """One job of a sweep, or the only one."""
    folder = configuration.current_folder()
    try:
        train(config, folder)
        finished.append(folder)
    except (ConfigError, ResultsError, OmegaConfBaseException, OSError, MemoryError) as error:
        if not any(folder.iterdir()):
            folder.rmdir()
        line = configuration.describe(error)
        failed.append(f"{folder.name}: {line}" if configuration.is_multirun() else line)
        print(f"error: {failed[-1]}", file=sys.stderr)


def train(config: DictConfig, folder: Path) -> None:
    """Run a job into its folder, unless it is there already."""
    choices = configuration.current_choices()
    configuration.check_keys(config, choices)
    configuration.fill_threshold(config)
    values = configuration.resolved(config)

    from trl_explore import results

    if results.is_finished(folder) and not config.restart:
        differences = configuration.differences(results.read_run(folder)["config"], values)
        if differences:
            raise ConfigError(
                f"{folder} holds a job of another configuration ({'; '.join(differences)}); "
                "restart=true begins anew"
            )
        print(f"{folder.name}: finished before, nothing to do (restart=true begins anew)")
        return

    import torch

    from trl_explore.console import Progress
    from trl_explore.threads import set_threads

    trainer = configuration.build_trainer(config)
    torch.set_num_threads(1)
    set_threads(config.threads)
    results.clear(folder)
    configuration.save_hydra(folder, config)
    progress = Progress(folder.name)
    trainer.on_iteration = progress
    started = time.perf_counter()
    try:
        trials = trainer.run()
    finally:
        progress.close()
        trainer.collector.shutdown()
    results.write_job(
        folder,
        trials,
        dict(trainer.collector.policy[0].named_parameters()),
        config=values,
        experiment=choices.get("experiment") or "train",
        strategy=str(choices["strategy"]),
        collector=type(trainer.collector).__name__,
        seconds=time.perf_counter() - started,
        episodes=config.episodes,
    )


def main() -> int:
    """Run Hydra; anything that the user did wrong is one line on stderr, and status 1."""
    show_traceback = bool(os.environ.get("HYDRA_FULL_ERROR"))
    logging.basicConfig(format="%(message)s", stream=sys.stderr)
    logging.getLogger("trl_explore").setLevel(logging.INFO)
    os.environ["HYDRA_FULL_ERROR"] = "1"  # hand errors over instead of printing tracebacks
    configuration.register_resolvers()
    try:
        run()
        if finished:
            show(finished)
    except (HydraException, OmegaConfBaseException, ValueError, OSError) as error:
        if show_traceback:
            raise
        print(f"error: {configuration.describe(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; finished jobs are kept, the same command goes on", file=sys.stderr)
        return 130
    if failed and finished:
        print(f"{len(failed)} of {len(failed) + len(finished)} jobs failed", file=sys.stderr)
    return 1 if failed else 0


def show(folders: list[Path]) -> None:
    """The table over all jobs, and where the files are."""
    from trl_explore.console import table
    from trl_explore.results import read_job

    print(table(read_job(folder) for folder in folders))
    print(f"results: {folders[0] if len(folders) == 1 else folders[0].parent}")


if __name__ == "__main__":
    sys.exit(main())
