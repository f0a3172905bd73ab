"""Write the report: ``trl-explore report STUDY.yaml`` or ``DIR [DIR ...]``, ``[--out DIR]``."""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from trl_explore.commands import logs
from trl_explore.jobs.columns import ResultsError
from trl_explore.jobs.console import printable, tell
from trl_explore.report.build import build_report
from trl_explore.report.study_file import THESIS, StudyFile, read_study

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
    logs.add_arguments(parser)
    arguments = parser.parse_args()
    try:
        logs.check(arguments)
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
            page, gaps = logs.report(arguments, out), []
        else:
            page, gaps = build_report(folders, out, study, _say)
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


def _say(stage: str) -> None:
    print(stage, file=sys.stderr, flush=True)
