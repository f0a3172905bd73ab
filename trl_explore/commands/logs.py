"""``trl-explore report --from PROGRAM DIR ...``: the arguments for runs of other programs."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from trl_explore.jobs.columns import ResultsError
from trl_explore.jobs.console import text_table
from trl_explore.logs.csv_files import USUAL
from trl_explore.logs.measures import tasks
from trl_explore.logs.runs import READERS, read_runs

if TYPE_CHECKING:
    from trl_explore.report.tables import Column


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments to those of ``report``."""
    group = parser.add_argument_group(
        "runs of other programs", "with --from, DIR holds the runs of another program, or is a file"
    )
    group.add_argument("--from", dest="source", choices=READERS, help="the program")
    group.add_argument(
        "--dry-run", action="store_true", help="show which runs were found; compute nothing"
    )
    group.add_argument(
        "--column", action="append", default=[], metavar="score=NAME",
        help="which quantity is the score; for csv also step, seed, configuration (A,B: of two"
        " columns), environment, run",
    )  # fmt: skip
    group.add_argument("--threshold", type=float, help="a run has passed when its score exceeds it")
    group.add_argument("--window", type=int, help="smooth the score over this number of points")
    group.add_argument("--horizon", type=float, help="the last step that counts")
    group.add_argument(
        "--pattern", metavar="REGEX",
        help="finds (?P<configuration>...), (?P<environment>...) and (?P<seed>...) in paths",
    )  # fmt: skip


def check(arguments: argparse.Namespace) -> None:
    """Refuse the arguments of runs of other programs without ``--from``."""
    for name in ("column", "threshold", "window", "horizon", "pattern", "dry_run"):
        if not arguments.source and getattr(arguments, name):
            flag = f"--{name.replace('_', '-')}"
            raise ResultsError(f"{flag}: only with --from, for runs of another program")


def report(arguments: argparse.Namespace, out: Path) -> Path | None:
    """Print the runs that were found, and write the page; None if it is a dry run.

    Raises:
        ResultsError: a wrong argument, or files that cannot be read; one line.
    """
    columns, pattern = _columns(arguments.column), _pattern(arguments.pattern)
    if arguments.window is not None and arguments.window < 1:
        raise ResultsError(f"--window must be an integer >= 1, got {arguments.window}")
    from trl_explore.report.logs import build_page, groups_table, runs_table

    runs, others = read_runs(arguments.source, arguments.folders, columns=columns, pattern=pattern)
    print(f"score: {runs[0].score}; steps: {runs[0].step}")
    for table in (runs_table(runs), groups_table(runs)):
        rows = [[column.title for column in table.columns], *table.rows()]
        print("\n".join(["", *text_table(rows, left=_left(table.columns))]))
    if others:
        print(f"\nalso logged by all runs (--column score=NAME): {', '.join(others[:20])}")
    found = tasks(
        runs, threshold=arguments.threshold, window=arguments.window, horizon=arguments.horizon
    )
    for task in found:
        print(
            f"\n{task.environment or 'all runs'}: judged up to step {task.horizon:,.0f}, smoothed"
            f" over {task.window} {'points' if task.window > 1 else 'point'}"
        )
        print("".join(f"  {note}\n" for note in task.notes), end="")
    if arguments.dry_run:
        return None
    return build_page(runs, found, out, source=arguments.source, others=others)


def _left(columns: Sequence[Column]) -> set[int]:
    return {i for i, column in enumerate(columns) if not column.numeric}


def _columns(words: list[str]) -> dict[str, str]:
    columns = {}
    for word in words:
        role, equals, name = word.partition("=")
        if role not in USUAL or not equals or not name:
            raise ResultsError(
                f"--column {word}: must be ROLE=NAME, ROLE one of {', '.join(USUAL)}"
            )
        columns[role] = name
    return columns


def _pattern(text: str | None) -> re.Pattern[str] | None:
    if text is None:
        return None
    try:
        pattern = re.compile(text)
    except re.error as error:
        raise ResultsError(f"--pattern {text!r} is not a regular expression: {error}") from None
    if not set(pattern.groupindex) & {"configuration", "environment", "seed"}:
        raise ResultsError(
            f"--pattern {text!r} has no group (?P<configuration>...), (?P<environment>...) or"
            " (?P<seed>...)"
        )
    return pattern
