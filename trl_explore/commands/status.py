"""Show the status of sweeps: ``trl-explore status DIR [DIR ...] [--all] [--verify] [--watch]``."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from shutil import get_terminal_size

from trl_explore.jobs.console import tell
from trl_explore.jobs.files import ResultsError, flaws
from trl_explore.jobs.status import DONE, RUNNING, SHOWN, SweepStatus, status_lines, survey

EVERY = 2.0
"""Seconds between two looks of ``--watch``."""


def main() -> int:
    """Show the status of sweeps; an error prints one line on stderr and returns status 1."""
    parser = argparse.ArgumentParser(
        description="Show which jobs of a sweep are done, running, failed or left."
    )
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="job or sweep folder")
    parser.add_argument(
        "--all",
        action="store_true",
        help=f"also list finished jobs in sweeps with over {SHOWN} jobs",
    )
    parser.add_argument(
        "--verify",
        action="store_true",
        help="also compare every file of the finished jobs with the digest in run.json",
    )
    parser.add_argument(
        "--watch", action="store_true", help="show it again every 2 s until no job is running"
    )
    arguments = parser.parse_args()
    changed = 0
    try:
        if arguments.watch:
            watch(arguments.folders, everything=arguments.all)
            return 0
        for sweep in survey(arguments.folders):
            print(status_lines(sweep, everything=arguments.all))
            if arguments.verify:
                changed += verify(sweep)
    except ResultsError as error:
        tell(error)
        return 1
    return 1 if changed else 0


def watch(folders: list[Path], *, everything: bool = False) -> None:
    """Show the status again and again, in place on a terminal, until no job is running.

    Elsewhere, print the first line of each sweep whenever it has changed.
    """
    before: dict[Path, str] = {}
    while True:
        sweeps = survey(folders)
        texts = {sweep.folder: status_lines(sweep, everything=everything) for sweep in sweeps}
        if sys.stdout.isatty():
            width, height = get_terminal_size()
            lines = "\n".join(texts.values()).splitlines()[: height - 1]
            print("\033[H\033[J" + "\n".join(line[:width] for line in lines), flush=True)
        else:
            heads = {folder: text.splitlines()[0] for folder, text in texts.items()}
            for folder, head in heads.items():
                if before.get(folder) != head:
                    print(head, flush=True)
            before = heads
        if not any(sweep.counts()[RUNNING] for sweep in sweeps):
            return
        time.sleep(EVERY)


def verify(sweep: SweepStatus) -> int:
    """Print a line for every file that is not the one its job wrote; returns their number."""
    done = [job.name for job in sweep.jobs if job.state == DONE]
    found = [flaw for name in done for flaw in flaws(sweep.folder / name)]
    for flaw in found:
        tell(flaw, "warning")
    if not found:
        print(f"  every file of {len(done)} finished jobs is unchanged")
    return len(found)
