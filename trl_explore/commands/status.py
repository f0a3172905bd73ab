"""Show the status of sweeps: ``trl-explore status DIR [DIR ...] [--all] [--verify]``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from trl_explore.jobs.console import tell
from trl_explore.jobs.files import ResultsError, flaws
from trl_explore.jobs.status import DONE, SHOWN, SweepStatus, report, survey


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
    arguments = parser.parse_args()
    changed = 0
    try:
        for sweep in survey(arguments.folders):
            print(report(sweep, everything=arguments.all))
            if arguments.verify:
                changed += verify(sweep)
    except ResultsError as error:
        tell(error)
        return 1
    except BrokenPipeError:  # the reader, such as "| head", has closed the pipe
        sys.stderr.close()
    return 1 if changed else 0


def verify(sweep: SweepStatus) -> int:
    """Print a line for every file that is not the one its job wrote; returns their number."""
    done = [job.name for job in sweep.jobs if job.state == DONE]
    found = [flaw for name in done for flaw in flaws(sweep.folder / name)]
    for flaw in found:
        tell(flaw, "warning")
    if not found:
        print(f"  every file of {len(done)} finished jobs is unchanged")
    return len(found)
