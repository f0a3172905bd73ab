"""Write the report: ``trl-explore report DIR [DIR ...] [--out DIR]``."""

from __future__ import annotations

import argparse
from pathlib import Path

from trl_explore.commands import logs
from trl_explore.jobs.columns import ResultsError
from trl_explore.jobs.console import printable, tell
from trl_explore.report.build import build_report


def main() -> int:
    """Write the report; an error prints one line on stderr and returns status 1."""
    parser = argparse.ArgumentParser(
        description="Write one HTML page with figures and tables from any set of job and sweep"
        " folders."
    )
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="job or sweep folder")
    parser.add_argument("--out", type=Path, help="folder of the report (default: first DIR/report)")
    logs.add_arguments(parser)
    arguments = parser.parse_args()
    out = arguments.out or arguments.folders[0] / "report"
    try:
        if arguments.source:
            page, gaps = logs.report(arguments, out), []
        else:
            page, gaps = build_report(arguments.folders, out)
    except ResultsError as error:
        tell(error)
        return 1
    except OSError as error:
        tell(f"cannot write {error.filename}: {error.strerror}")
        return 1
    for gap in gaps:
        tell(f"left out {gap.what}: {gap.why}", "warning")
    if page:
        print(printable(str(page)))
    return 0
