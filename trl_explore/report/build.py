"""Build the report from folders of results."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from trl_explore.jobs.columns import ResultsError
from trl_explore.report.claims import claims_table, why_tables
from trl_explore.report.evidence import gather
from trl_explore.report.figures import draw_all, draw_why
from trl_explore.report.loading import Gap, load
from trl_explore.report.page import TITLE, Content, page
from trl_explore.report.results_tables import (
    comparison_table,
    gaps_table,
    jobs_table,
    summary_table,
)
from trl_explore.report.tables import Table
from trl_explore.report.why import decomposition_tables

PAGE, FIGURES, TABLES = "index.html", "figures", "tables"


def build_report(folders: Sequence[Path], out: Path) -> tuple[Path, list[Gap]]:
    """Write the report on every finished job at or below the folders.

    Args:
        folders: job or sweep folders, any number.
        out: folder of the report; ``figures/`` and ``tables/`` of an earlier report are replaced.

    Returns:
        Path of the page, and what is missing from the report.

    Raises:
        ResultsError: there is nothing to report; the message is one line.

    """
    evidence = gather(load(folders))
    figures = {part.group.id: list(draw_all(part)) for part in evidence.groups}
    tables: dict[str, list[Table]] = {
        part.group.id: [
            summary_table(part),
            comparison_table(part),
            *([comparison_table(part.learned, learned=True)] if part.learned else []),
        ]
        for part in evidence.groups
    }
    content = Content(
        evidence=evidence,
        figures=figures,
        tables=tables,
        jobs=jobs_table(evidence),
        gaps=gaps_table(evidence),
        why=why_tables(evidence),
        parts=decomposition_tables(evidence.decompositions),
        acting=list(draw_why(evidence.decompositions)),
    )
    html = page(content)
    _clear(out)
    for group in [*figures.values(), content.acting]:
        for figure in group:
            _write(out / FIGURES / f"{figure.id}.svg", figure.svg)
            _fresh(out / FIGURES / f"{figure.id}.png").write_bytes(figure.png)
    for table in [
        claims_table(evidence.checked), content.jobs, content.gaps, *content.parts, *content.why,
        *(t for part in tables.values() for t in part),
    ]:  # fmt: skip
        _write_table(out / TABLES, table)
    _write(out / PAGE, html)
    return out / PAGE, evidence.gaps


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
    if (out / PAGE).is_file() and TITLE in (out / PAGE).read_text(
        encoding="utf-8", errors="replace"
    ):
        for name in (FIGURES, TABLES):
            shutil.rmtree(out / name, ignore_errors=True)
    for name in (FIGURES, TABLES):
        (out / name).mkdir(parents=True, exist_ok=True)


def _write_table(folder: Path, table: Table) -> None:
    if not table.records:
        return
    _write(folder / f"{table.id}.csv", table.to_csv())
    if table.main:
        _write(folder / f"{table.id}.tex", table.to_latex())
        _write(folder / f"{table.id}.md", table.to_markdown())


def _write(path: Path, text: str) -> None:
    _fresh(path).write_text(text, encoding="utf-8", newline="\n")


def _fresh(path: Path) -> Path:
    """Remove an existing file or link, so that writing cannot follow a link."""
    path.unlink(missing_ok=True)
    return path
