"""The page: one HTML file that loads nothing, and reads well without JavaScript."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.metadata import version
from importlib.resources import files

from trl_explore.report import prose, why
from trl_explore.report.catalogue import Drawn
from trl_explore.report.claims_table import PLURAL, claims_table, tally
from trl_explore.report.evidence import SEED, Evidence, GroupEvidence
from trl_explore.report.kinds import DIAGNOSTICS
from trl_explore.report.tables import Table
from trl_explore.report.theme import inline_svg, theme_css
from trl_explore.thesis import NOT_MEASURED

LONG_TABLE = 20
HEROES = ("survival", "effects", "map-pass")
"""Kinds of figures of which the first stands beside the answer."""
RECORDED = {*DIAGNOSTICS, "entropy"}
PACKAGES = ("numpy", "scipy", "matplotlib")


@dataclass(frozen=True)
class Content:
    """What a page shows: figures and tables by the id of their group."""

    evidence: Evidence
    figures: Mapping[str, Sequence[Drawn]]
    tables: Mapping[str, Sequence[Table]]
    claims: Table
    jobs: Table
    gaps: Table
    why: Sequence[Table] = ()


def page(content: Content) -> str:
    """The whole file."""
    evidence = content.evidence
    figures = [figure for group in content.figures.values() for figure in group]
    hero = next((f for f in figures if f.kind in HEROES), None)
    body = "\n".join(
        [
            _header(content),
            _gaps(content),
            _answer(evidence),
            _figure(hero) if hero else "",
            _claims(content),
            _why(content, hero),
            *(_group(part, content, hero) for part in evidence.groups),
            _method(evidence),
            _provenance(content),
        ]
    )
    css = files("trl_explore.report").joinpath("page.css").read_text(encoding="utf-8")
    script = files("trl_explore.report").joinpath("page.js").read_text(encoding="utf-8")
    policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}; img-src data:">\n'
        '<link rel="icon" href="data:,">\n'
        f"<title>{TITLE}</title>\n<style>\n{css}{theme_css(f.svg for f in figures)}\n</style>\n"
        f"</head>\n<body>\n{body}\n<script>\n{script}</script>\n</body>\n</html>\n"
    )


TITLE = "What does the exploration strategy do to learning?"


def _header(content: Content) -> str:
    evidence = content.evidence
    trials = sum(len(c) for part in evidence.groups for c in part.group.configurations)
    frames = sum(s.frames_total for part in evidence.groups for s in part.summaries)
    entries = [("answer", "Answer"), ("claims-section", "The thesis’s statements")]
    entries += [("why", "Why")] * bool(content.why)
    entries += [(part.group.id, part.group.title) for part in evidence.groups]
    entries += [("method", "Method"), ("provenance", "Provenance")]
    links = "".join(f'<li><a href="#{escape(i)}">{escape(t)}</a></li>' for i, t in entries)
    return (
        f'<header><h1>{TITLE}</h1><p class="facts">{trials:,} trials,'
        f" {frames:,} frames, {len(evidence.outcomes)} jobs.</p></header>"
        f'<nav aria-label="Contents"><ul>{links}</ul></nav>'
        f'<section class="prose" aria-label="The question">{prose.question(evidence)}</section>'
    )


def _gaps(content: Content) -> str:
    if not content.gaps.records:
        return ""
    return (
        '<section class="gap" id="gaps"><p><b>This report is incomplete.</b>'
        " What is listed here should have been in it:</p>"
        f"{content.gaps.to_html()}</section>"
    )


def _answer(evidence: Evidence) -> str:
    sentences = "".join(f"<p>{escape(sentence)}</p>" for sentence in evidence.answer)
    return (
        f'<section id="answer"><h2>The answer</h2><div class="answer">{sentences}</div></section>'
    )


def _figure(figure: Drawn) -> str:
    number = f" (figure {figure.thesis} of the thesis)" if figure.thesis else ""
    return (
        f'<figure id="figure-{escape(figure.id)}">'
        f"{inline_svg(figure.svg, figure.id, figure.alt)}"
        f"<figcaption><b>{escape(figure.title)}{number}.</b> {escape(figure.caption)}"
        "</figcaption></figure>"
    )


def _claims(content: Content) -> str:
    counts = tally(content.evidence.checked)
    items = "".join(
        f'<li class="verdict {verdict.replace(" ", "-")}">{count}'
        f" {PLURAL.get(verdict, verdict) if count > 1 else verdict}</li>"
        for verdict, count in counts.items()
    )
    table = content.claims.to_html()
    missing = [c for c in content.evidence.checked if c.finding.verdict == NOT_MEASURED]
    if 2 * len(missing) > len(content.evidence.checked):
        known = [c for c in content.evidence.checked if c not in missing]
        table = claims_table(known).to_html() if known else ""
        title = "Not measured, with the reason"
        rest = claims_table(missing, id="claims-missing", title=title).to_html()
        table += f"<details><summary>{len(missing)} not measured</summary>{rest}</details>"
    return (
        '<section id="claims-section"><h2>The thesis’s statements, checked one by one</h2>'
        '<p class="prose">The study that this program starts from, “Dare to Discover: The Effect'
        " of the Exploration Strategy on an Agent’s Performance”, made these statements. Each one"
        " is decided by a test, never by looking at a mean; <i>taken to mean</i> says what the"
        f' words are taken to mean.</p><ul class="tally">{items}</ul>{table}</section>'
    )


def _why(content: Content, hero: Drawn | None) -> str:
    if not content.why:
        return ""
    shown = [
        figure
        for part in content.evidence.groups
        if why.applies(part)
        for figure in content.figures[part.group.id]
        if figure.kind in why.FIGURES and figure is not hero
    ]
    effects, distances = (
        "".join(_figure(f) for f in shown if (f.kind == why.EFFECTS) is first)
        for first in (True, False)
    )
    tables = [table.to_html() for table in content.why]
    return why.why_section(content.evidence, effects, distances, tables)


def _group(part: GroupEvidence, content: Content, hero: Drawn | None) -> str:
    group = part.group
    elsewhere = [
        f
        for f in content.figures[group.id]
        if f is hero or (content.why and why.applies(part) and f.kind in why.FIGURES)
    ]
    figures = [f for f in content.figures[group.id] if f not in elsewhere]
    links = ", ".join(f'<a href="#figure-{escape(f.id)}">{escape(f.title)}</a>' for f in elsewhere)
    seen = f'<p class="facts">Above: {links}.</p>' if elsewhere else ""
    main = part is content.evidence.groups[0]  # whose sentences are the answer
    notes = [] if main else [f"<p>{escape(sentence)}</p>" for sentence in part.sentences]
    if part.incomparable:
        notes.append(f"<p>No comparison: {escape(part.incomparable)}.</p>")
    absent = []
    if not any(f.kind == "seconds" for f in content.figures[group.id]):
        absent.append("seconds of single trials (none was timed by itself)")
    if not part.learning and not group.is_grid and group.plane is None:
        absent.append("learning curves (not recorded)")
    if absent:
        notes.append(f'<p class="facts">Left out: {escape("; ".join(absent))}.</p>')
    tables = "".join(map(_table, content.tables[group.id]))
    recorded = [f for f in figures if f.kind in RECORDED]
    drawings = "".join(_figure(f) for f in figures if f not in recorded)
    more = (
        f"<details><summary>Along the runs: {len(recorded)} more figures</summary>"
        f'<div class="figures">{"".join(map(_figure, recorded))}</div></details>'
        if recorded
        else ""
    )
    return (
        f'<section id="{escape(group.id)}"><h2>{escape(group.title)}</h2>'
        f'<p class="facts">{prose.group_facts(group)}</p><div class="prose">{"".join(notes)}'
        f'{seen}</div><div class="figures">{drawings}</div>{more}{tables}</section>'
    )


def _table(table: Table) -> str:
    """A table; a long one opens on a click."""
    if not table.records:
        return ""
    if len(table.records) <= LONG_TABLE:
        return table.to_html()
    summary = f"{table.title} ({len(table.records)} rows)"
    return f"<details><summary>{escape(summary)}</summary>{table.to_html()}</details>"


def _method(evidence: Evidence) -> str:
    return (
        '<section id="method"><h2>Method</h2><div class="prose">'
        f"{prose.method(evidence)}<h3>Tuning</h3>{prose.fairness(evidence)}</div></section>"
    )


def _provenance(content: Content) -> str:
    evidence = content.evidence
    source = [o.provenance for o in evidence.outcomes]
    versions: dict[str, set[str]] = {}
    for entry in source:
        for name, value in dict(entry.get("versions") or {}).items():
            versions.setdefault(str(name), set()).add(str(value))
    machines = {" ".join(map(str, dict(e.get("machine") or {}).values())) for e in source}
    caps = sorted({o.cap for o in evidence.outcomes})
    pairs = [
        (
            "trials made with",
            _joined(f"{k} {' and '.join(sorted(v))}" for k, v in versions.items()),
        ),
        ("analysed with", _joined(f"{name} {version(name)}" for name in PACKAGES)),
        ("machine", _joined(sorted(machines))),
        ("collectors", _joined(sorted({str(e.get("collector")) for e in source}))),
        ("seeds of trials", _joined(sorted({str(e.get("seed")) for e in source}))),
        ("caps", _joined(f"{cap:,} iterations" for cap in caps)),
        ("seed of all resampling", str(SEED)),
    ]
    listing = "".join(
        f"<li><code>figures/{escape(f.id)}</code> .svg, .png</li>"
        for group in content.figures.values()
        for f in group
    )
    return (
        f'<section id="provenance"><h2>Provenance</h2>{prose.facts(pairs)}'
        '<p class="prose">Each line of this table makes its job again; jobs of a named experiment'
        " are made together by <code>python scripts/train.py experiment=NAME</code>. The report is"
        " made by <code>python scripts/report.py DIR</code>, the same bytes each time.</p>"
        f'{content.jobs.to_html()}<details class="screen"><summary>Files beside this page'
        "</summary><p>Every table as CSV in <code>tables/</code>, the main ones also as LaTeX and"
        f" Markdown; every figure:</p><ul>{listing}</ul></details></section>"
    )


def _joined(parts: Sequence[str] | object) -> str:
    return ", ".join(parts) or "not recorded"  # type: ignore[arg-type]
