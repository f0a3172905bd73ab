"""Show the status of sweeps: ``trl-explore status DIR [DIR ...] [--all]``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from trl_explore.jobs.columns import ResultsError
from trl_explore.jobs.status import SHOWN, report, survey


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
    arguments = parser.parse_args()
    try:
        for sweep in survey(arguments.folders):
            print(report(sweep, everything=arguments.all))
    except ResultsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:  # the reader, such as "| head", has closed the pipe
        sys.stderr.close()
    return 0
