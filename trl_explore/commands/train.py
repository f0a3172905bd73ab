"""``trl-explore train [-m] [key=value ...]``; ``--help`` lists the keys."""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import hydra
from hydra._internal.utils import get_args_parser
from hydra.errors import HydraException

from trl_explore import config as configuration
from trl_explore.commands.job import EXPECTED, run
from trl_explore.commands.main import TRACEBACK
from trl_explore.config import CONF, ConfigError, sweeping, tuning_value
from trl_explore.config.files import check_folder
from trl_explore.config.nodes import speed_up_omegaconf
from trl_explore.jobs import signals
from trl_explore.jobs.console import tell
from trl_explore.jobs.signals import Interrupted


def main(action: Callable[[], int] | None = None) -> int:
    """Run Hydra; a user error prints one line on stderr and returns status 1.

    Args:
        action: what to do with the words of the command; by default, run their jobs.
    """
    logging.getLogger("trl_explore").setLevel(logging.INFO)
    os.environ.setdefault(TRACEBACK, os.environ.get("HYDRA_FULL_ERROR", ""))
    os.environ["HYDRA_FULL_ERROR"] = "1"  # make Hydra raise errors instead of printing tracebacks
    configuration.register_resolvers()
    speed_up_omegaconf()
    sys.argv[1:] = sorted(sys.argv[1:], key=_place)
    try:
        return _reported(action or sweep)
    except Interrupted as error:
        print(f"{error}{error.where}; run the same command to resume", file=sys.stderr)
        return error.status


def _place(word: str) -> int:
    """Put flags first and overrides last: argparse rejects overrides on both sides of a flag."""
    if word in ("-m", "--multirun"):
        return 0
    return 2 if word[:1] == "~" or (word[:1] != "-" and "=" in word) else 1


def own_folder() -> Path:
    """The folder that Hydra searches first: the user's (``--config-dir``), if there is one.

    Hydra searches the folder of ``--config-dir`` last, so the two are exchanged.

    Raises:
        ConfigError: if the folder cannot be read.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config-dir", "-cd", type=Path)
    found, others = parser.parse_known_args(sys.argv[1:])
    if found.config_dir is None:
        return CONF
    check_folder(found.config_dir)
    sys.argv[1:] = [f"--config-dir={CONF}", *others]
    return found.config_dir.resolve()


def check_flags() -> None:
    """Reject an unknown flag.

    Raises:
        ConfigError: naming it.
    """

    def refuse(message: str) -> NoReturn:
        raise ConfigError(f"{message}; --hydra-help lists the flags")

    parser = get_args_parser()
    parser.error = refuse
    parser.parse_args()


def _reported(action: Callable[[], int]) -> int:
    """The exit status of an action; an error of the user is one line on stderr, and status 1."""
    try:
        return action()
    except BrokenPipeError:
        raise
    except Exception as error:
        signals.check()
        if os.environ.get(TRACEBACK) or not isinstance(error, (HydraException, *EXPECTED)):
            raise
        grammar = isinstance(error, HydraException | ValueError)
        unread = configuration.unreadable(sys.argv[1:]) if grammar else ""
        tell(unread or configuration.describe(error))
        return 1


def run_jobs() -> list[sweeping.Ended]:
    """Run all jobs of the words in ``sys.argv``; return how each ended."""
    signals.raise_on_signals()
    check_flags()
    folder = own_folder()
    start = hydra.main(version_base="1.3", config_path=str(folder), config_name="train")
    jobs = sweeping.collect(start(run))
    signals.check()
    return jobs


def sweep() -> int:
    """Run all jobs of the command; return the exit status."""
    jobs = run_jobs()
    finished = [job.folder for job in jobs if not job.error]
    failed = [job for job in jobs if job.error]
    if finished:
        show(finished)
        if text := tuning_value.best(finished[0].parent):
            print(text)
    if len(jobs) > 1 and failed:
        print(f"{len(failed)} of {len(jobs)} jobs failed:", file=sys.stderr)
        for job in failed:
            print(f"  {job.line}", file=sys.stderr)
    return 1 if failed else 0


def show(folders: list[Path]) -> None:
    """Print the table of all jobs, and the folder of the results."""
    from trl_explore.jobs.console import table, warnings
    from trl_explore.jobs.reading import read_job

    jobs = [read_job(folder) for folder in folders]
    print("\n".join([table(jobs), *warnings(jobs)]))
    print(f"results: {folders[0] if len(folders) == 1 else folders[0].parent}")
