"""Write the report: ``trl-explore report STUDY.yaml`` or ``DIR [DIR ...]``, ``[--out DIR]``."""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from trl_explore.jobs.console import Bar, printable, tell, text_table
from trl_explore.jobs.files import ResultsError
from trl_explore.logs.csv_files import USUAL
from trl_explore.logs.measures import tasks
from trl_explore.logs.readers import READERS, read_runs
from trl_explore.report.study_file import THESIS, StudyFile, read_study
from trl_explore.report.writing import build_report

STUDIES = (".yaml", ".yml")
PROGRAM = "import sys; from trl_explore.commands.main import main; sys.exit(main(sys.argv[1:]))"


def main() -> int:
    """Write the report; an error prints one line on stderr and returns status 1."""
    parser = argparse.ArgumentParser(
        description="Write one HTML page with figures and tables from any set of job and sweep"
        " folders, or from a study: a YAML file that says what is asked of which configurations."
    )
    parser.add_argument("places", nargs="+", type=Path, metavar="STUDY.yaml|DIR",
                        help="a study, or job and sweep folders; a study with folders is asked of"
                        " them")  # fmt: skip
    parser.add_argument("--out", type=Path, help="folder of the report (default: first DIR/report,"
                        " or, for a study that only runs sweeps, STUDY/report)")  # fmt: skip
    _add_arguments(parser)
    arguments = parser.parse_args()
    try:
        _check(arguments)
        study, folders = _study(arguments.places)
        if study is not None and arguments.source:
            raise ResultsError(f"{study.path}: a study has no runs of other programs (--from)")
        first = folders[0] if folders else Path()
        path = study.path if study else None
        beside = path.with_suffix("") if path and not folders else first
        out = arguments.out or beside / "report"
        if study is not None:
            folders += [_run(study, words) for words in study.sweeps]
        if arguments.source:
            arguments.folders = folders
            page, gaps = _report_logs(arguments, out), []
        else:
            bar = Bar("report")
            try:
                page, gaps = build_report(folders, out, study, partial(_say, bar))
            finally:
                bar.close()
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


def _study(places: Sequence[Path]) -> tuple[StudyFile | None, list[Path]]:
    """The study, if one is given, and the folders."""
    files = [place for place in places if place.suffix in STUDIES and not place.is_dir()]
    if len(files) > 1:
        raise ResultsError(f"{files[1]}: one study at a time, after {files[0]}")
    folders = [place for place in places if place not in files]
    if not files:
        return None, folders
    own = files[0].exists() or files[0] != Path(THESIS.name)
    study = read_study(files[0] if own else THESIS)
    folders = folders or list(study.folders)
    if not folders and not study.sweeps:
        allowed = "a list of folders, globs or sweeps is needed, or folders given with the study"
        raise ResultsError(f"{files[0]}: configurations=[]: {allowed}")
    return study, folders


def _run(study: StudyFile, words: Sequence[str]) -> Path:
    """Run a sweep of the study; jobs that are finished are not run again. Returns its folder."""
    assert study.path is not None
    folder = study.path.with_suffix("")
    given = [word.partition("=")[2] for word in words if word.startswith("output_dir=")]
    output = Path(given[0]) if given else folder / "runs"
    command = [sys.executable, "-c", PROGRAM, "train", "-m", *words]
    command += [] if given else [f"output_dir={output}"]
    if study.budget is not None:
        command += ["until=settled", f"budget={study.budget}", "--measure", study.measures[0]]
        command += ["--level", str(study.level)]
    if subprocess.run(command, check=False, stdout=sys.stderr).returncode:
        raise ResultsError(f"{study.path}: sweep={list(words)}: trl-explore train failed")
    return output


def _say(bar: Bar, done: float, stage: str) -> None:
    """Show the stage that begins in the bar; a plain line where there is no terminal."""
    if bar.live:
        bar.show(done, 1, stage)
    else:
        print(stage, file=sys.stderr, flush=True)


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for runs of other programs."""
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
    group.add_argument(
        "--threshold", action="append", default=[], metavar="[ENVIRONMENT=]SCORE",
        help="a run has passed when its score exceeds it; of all environments, or of one",
    )  # fmt: skip
    group.add_argument("--window", type=int, help="smooth the score over this number of points")
    group.add_argument("--horizon", type=float, help="the last step that counts")
    group.add_argument(
        "--pattern", metavar="REGEX",
        help="finds (?P<configuration>...), (?P<environment>...) and (?P<seed>...) in paths",
    )  # fmt: skip


def _check(arguments: argparse.Namespace) -> None:
    """Refuse the arguments of runs of other programs without ``--from``."""
    for name in ("column", "threshold", "window", "horizon", "pattern", "dry_run"):
        if not arguments.source and getattr(arguments, name):
            flag = f"--{name.replace('_', '-')}"
            raise ResultsError(f"{flag}: only with --from, for runs of another program")


def _report_logs(arguments: argparse.Namespace, out: Path) -> Path | None:
    """Print the runs that were found, and write the page; None if it is a dry run."""
    columns, pattern = _columns(arguments.column), _pattern(arguments.pattern)
    if arguments.window is not None and arguments.window < 1:
        raise ResultsError(f"--window must be an integer >= 1, got {arguments.window}")
    from trl_explore.report.other_programs import build_page, groups_table, runs_table

    runs, others = read_runs(arguments.source, arguments.folders, columns=columns, pattern=pattern)
    print(f"score: {runs[0].score}; steps: {runs[0].step}")
    for table in (runs_table(runs), groups_table(runs)):
        rows = [[column.title for column in table.columns], *table.rows()]
        left = {i for i, column in enumerate(table.columns) if not column.numeric}
        print("\n".join(["", *text_table(rows, left=left)]))
    if others:
        print(f"\nalso logged by all runs (--column score=NAME): {', '.join(others[:20])}")
    found = tasks(
        runs,
        threshold=_threshold(arguments.threshold),
        window=arguments.window,
        horizon=arguments.horizon,
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


def _threshold(words: list[str]) -> float | dict[str, float] | None:
    """One threshold for all environments, or one for each that is named."""
    found = {}
    for word in words:
        name, _, value = word.rpartition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise ResultsError(
                f"--threshold {word}: must be SCORE or ENVIRONMENT=SCORE, SCORE a number"
            ) from None
    if "" in found and len(words) > 1:
        raise ResultsError("--threshold: one for all environments, or ENVIRONMENT=SCORE for each")
    return found.get("", found or None)


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
