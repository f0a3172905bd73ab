"""Build the report from folders of results, or from a study."""

from __future__ import annotations

import gc
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from trl_explore.jobs.files import ResultsError
from trl_explore.report.evidence import gather
from trl_explore.report.figures import Picture, draw_all, draw_why
from trl_explore.report.loading import Gap, Say, load, silent
from trl_explore.report.methods import paragraph, references
from trl_explore.report.page import MARK, page
from trl_explore.report.study_file import StudyFile
from trl_explore.report.table_formats import Table

PAGE, FIGURES, TABLES = "index.html", "figures", "tables"
MAP = "map.html"
"""The page of ``trl-explore map``; the report links to it if it is in the same folder."""
METHODS, REFERENCES = "methods.md", "references.bib"


def build_report(
    folders: Sequence[Path], out: Path, study: StudyFile | None = None, say: Say = silent
) -> tuple[Path, list[Gap]]:
    """Write the report on every finished job at or below the folders.

    Args:
        folders: job or sweep folders, any number.
        out: folder of the report; ``figures/`` and ``tables/`` of an earlier report are replaced.
        study: what is asked; None: the questions are inferred from what differs.
        say: called at the start of every stage, with the share that is done and its name.

    Returns:
        Path of the page, and what is missing from the report.

    Raises:
        ResultsError: there is nothing to report, or the study does not fit the jobs; one line.
    """
    evidence = gather(load(folders, say), study, say)
    figures = {}
    n = len(evidence.groups)
    frozen = gc.get_freeze_count() > 0
    gc.freeze()  # while figures are drawn, no module and no result becomes garbage
    try:
        for k, part in enumerate(evidence.groups, start=1):
            say(0.5 + 0.4 * (k - 1) / n, f"figures {k} of {n}: {part.group.title}")
            figures[part.group.id] = list(draw_all(part))
        acting = list(draw_why(evidence.decompositions))
    finally:
        if not frozen:
            gc.unfreeze()
    say(0.9, "page")
    html, tables = page(evidence, figures, acting, MAP if (out / MAP).is_file() else "")
    pictures: list[Picture] = [f for group in figures.values() for f in group]
    texts = {METHODS: paragraph(evidence) + "\n", REFERENCES: references(evidence)}
    return write_page(out, html, [*pictures, *acting], tables, texts), evidence.gaps


def write_page(
    out: Path,
    html: str,
    figures: Sequence[Picture],
    tables: Sequence[Table],
    texts: Mapping[str, str] = MappingProxyType({}),
) -> Path:
    """Write a page with its figures, tables and further texts by name; return its path."""
    _clear(out)
    for figure in figures:
        _write(out / FIGURES / f"{figure.id}.svg", figure.svg)
        for kind in ("png", "pdf"):
            _fresh(out / FIGURES / f"{figure.id}.{kind}").write_bytes(getattr(figure, kind))
    for table in tables:
        if table.records:
            _write(out / TABLES / f"{table.id}.csv", table.to_csv())
        if table.records and table.main:
            _write(out / TABLES / f"{table.id}.tex", table.to_latex())
            _write(out / TABLES / f"{table.id}.md", table.to_markdown())
    for name, text in {**texts, PAGE: html}.items():
        _write(out / name, text)
    return out / PAGE


def _clear(out: Path) -> None:
    """Prepare the folder; remove only the figures and tables of an earlier report.

    Links are removed without touching their targets: a folder of results from someone else must
    not redirect the files of a report.
    """
    if out.is_symlink():
        raise ResultsError(f"{out} is a link; give a folder with --out")
    for name in (PAGE, FIGURES, TABLES):
        if (out / name).is_symlink():
            (out / name).unlink()
    if (out / PAGE).is_file() and MARK in (out / PAGE).read_text(
        encoding="utf-8", errors="replace"
    ):
        for name in (FIGURES, TABLES):
            shutil.rmtree(out / name, ignore_errors=True)
    for name in (FIGURES, TABLES):
        (out / name).mkdir(parents=True, exist_ok=True)


def _write(path: Path, text: str) -> None:
    _fresh(path).write_text(text, encoding="utf-8", newline="\n")


def _fresh(path: Path) -> Path:
    """Remove an existing file or link, so that writing cannot follow a link."""
    path.unlink(missing_ok=True)
    return path
