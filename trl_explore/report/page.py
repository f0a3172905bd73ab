"""The page: one self-contained HTML file that also works without JavaScript.

``page.html`` holds the text, ``parts.html`` the macros for figures and tables. The templates escape
all text from results; only drawings, style sheet and script are inserted unescaped.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from trl_explore.names import STRATEGIES, strategy_label
from trl_explore.report.evidence import Evidence, GroupEvidence
from trl_explore.report.figures import Drawn, Picture
from trl_explore.report.groups import Group
from trl_explore.report.image_files import inline_svg, theme_css
from trl_explore.report.methods import paragraph, settings_table
from trl_explore.report.results_tables import gaps_table, group_tables, jobs_table
from trl_explore.report.table_formats import Table, listed, span
from trl_explore.report.verdicts import claims_table, distance, tally, why_tables
from trl_explore.report.why import decomposition_tables, headline
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.thesis import NOT_MEASURED

TITLE = "What does the exploration strategy do to learning?"
MARK = "trl_explore report"
"""In every page, so that a later report may replace it."""
INLINE = 1_800_000
"""Most characters of drawings inside the page; further figures are files next to it."""
OPEN = 10
"""Statements that are shown before the rest is folded."""
PACKAGES = ("numpy", "scipy", "matplotlib")


def environment() -> Environment:
    """The template environment of the page, with escaping of all text."""
    found = Environment(
        loader=PackageLoader("trl_explore.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    found.globals["inline"] = lambda f: Markup(inline_svg(f.svg, f.id, f.alt))
    found.globals["inside"] = None  # every drawing is inside the page
    found.filters["code"] = _code
    return found


def page(
    evidence: Evidence, figures: Mapping[str, Sequence[Drawn]], acting: Sequence[Picture], map: str
) -> tuple[str, list[Table]]:
    """The HTML page as text, and its tables.

    Args:
        evidence: all results.
        figures: the figures by the id of their group.
        acting: those of the section *Why* that belong to no group.
        map: address of a map of the mixtures, or nothing.
    """
    parts, study, main = evidence.groups, evidence.study, evidence.groups[0].group
    drawn = [figure for part in parts for figure in figures[part.group.id]]
    hero = next((f for f in drawn if f.kind.hero), None)
    shown: list[Picture] = [*acting, *drawn]
    trials = sum(len(c) for part in parts for c in part.group.configurations)
    frames = sum(s.frames_total for part in parts for s in part.summaries)
    environments = dict.fromkeys(part.group.environment for part in parts)
    labels = list(dict.fromkeys(f.label for part in parts for f in part.group.factors))
    missing = [c for c in evidence.checked if c.finding.verdict == NOT_MEASURED]
    known = [c for c in evidence.checked if c not in missing]
    said, title = "statement", "The statements of this study"
    if study.claims == "thesis":
        said, title = "the thesis says", "The thesis's statements"
    settings, jobs, gaps = settings_table(evidence), jobs_table(evidence), gaps_table(evidence)
    why, divided = why_tables(evidence), decomposition_tables(evidence.decompositions)
    of_groups = {part.group.id: group_tables(part) for part in parts}
    sections = [_section(part, figures[part.group.id], hero, bool(why), part is parts[0])
                for part in parts]  # fmt: skip
    html = render(
        "page.html",
        ([hero] if hero else []) + shown,
        title=study.title or TITLE,
        evidence=evidence,
        study=study,
        facts=f"{trials:,} trials, {frames:,} frames, {len(evidence.outcomes)} jobs.",
        main=main,
        others=[name for name in environments if name != main.environment],
        differs=listed(labels) if labels else "",
        settings=settings,
        methods=paragraph(evidence),
        episodes=episodes_per_iteration(evidence.outcomes),
        strategies=_strategies(evidence.outcomes),
        gaps=gaps,
        map=map,
        hero=hero,
        claims_tally=tally(c.finding.verdict for c in known),
        claims=claims_table(known[:OPEN], said=said, title=title),
        claims_more=claims_table(known[OPEN:], id="claims-more", said=said, title="Further ones"),
        claims_missing=claims_table(
            missing, id="claims-missing", title="Not measured, with the reason", said=said
        ),
        claims_few=len(known) < len(missing),
        why={
            "tally": tally(r.outcome for r in evidence.reexamined),
            "tables": why,
            "acting": acting,
            "parts": divided,
            "headline": headline(evidence.decompositions),
            "figures": [f for section in sections for f in section["why"]],
            "distance": distance(evidence),
        } if why or divided else None,
        sections=sections,
        tables=of_groups,
        level=f"{100 * study.level:g} %",
        thesis=study.claims == "thesis" and bool(known),
        plane=any(part.group.plane is not None for part in parts),
        shared=[
            f"{'/'.join(s.first)} and {'/'.join(s.second)} ({s.count})"
            for s in evidence.shared
            if s.first[0] != s.second[0]
        ],
        provenance=_provenance(evidence),
        jobs=jobs,
        files=shown,
    )  # fmt: skip
    return html, [
        claims_table(evidence.checked), settings, jobs, gaps, *divided, *why,
        *(table for tables in of_groups.values() for table in tables),
    ]  # fmt: skip


def render(template: str, figures: Sequence[Picture], **parts: Any) -> str:
    """A page as text; the figures that fit, in this order, are inside it."""
    inside, left = set(), INLINE
    for figure in {f.id: f for f in figures}.values():
        left -= len(figure.svg)
        if left >= 0:
            inside.add(figure.id)
    found = environment()
    found.globals["inside"] = inside
    css = _file("page.css") + theme_css(f.svg for f in figures if f.id in inside)
    script = Markup(_file("page.js"))
    return found.get_template(template).render(mark=MARK, css=Markup(css), script=script, **parts)


def _code(text: str) -> Markup:
    """The text, escaped; text between backticks is code."""
    pieces = text.split("`")
    return Markup("").join(
        Markup("<code>{}</code>").format(piece) if k % 2 else piece
        for k, piece in enumerate(pieces)
    )


def episodes_per_iteration(outcomes: Iterable[Outcomes]) -> str:
    """The number of episodes per iteration, in words."""
    counts = sorted({int(o.config.get("episodes_per_update", 1)) for o in outcomes})
    return " or ".join("one episode" if k == 1 else f"{k} episodes" for k in counts)


def group_facts(group: Group) -> str:
    """One line that describes a group."""
    trials = span(len(c) for c in group.configurations)
    n = len(group.configurations)
    what = "1 configuration" if n == 1 else f"{n} configurations"
    judged_by = group.configurations[0].judged_by
    rule = f"passes with a mean score above {group.threshold:g} over {group.window} episodes"
    rule += "" if judged_by == "training" else f" of {judged_by}"
    if group.did == "learned":
        rule = f"has learned when its policy scores above {group.threshold:g} without exploration"
    return (
        f"{what} × {trials} trials of {group.environment}; a trial {rule}; cap {group.cap:,}"
        " iterations."
    )


def _file(name: str) -> str:
    return files("trl_explore.report").joinpath(name).read_text(encoding="utf-8")


def _strategies(outcomes: Sequence[Outcomes]) -> list[tuple[str, str]]:
    """Label of every strategy, and its description if there is one."""
    names = list(dict.fromkeys(o.strategy for o in outcomes))
    ordered = [n for n in STRATEGIES if n in names] + [n for n in names if n not in STRATEGIES]
    return [(strategy_label(n), STRATEGIES[n].does if n in STRATEGIES else "") for n in ordered]


def _section(
    part: GroupEvidence, drawn: Sequence[Drawn], hero: Drawn | None, why: bool, main: bool
) -> dict[str, Any]:
    """The section of a group; ``main`` if its sentences are in the answer."""
    group = part.group
    moved = [f for f in drawn if why and part.why and f.kind.why]
    above = [f for f in drawn if f is hero or f in moved]
    here = [f for f in drawn if f not in above]
    # What is alone is named in the answer.
    notes = [] if main or part.single else list(part.sentences)
    if part.incomparable:
        notes.append(f"No comparison: {part.incomparable}.")
    absent = []
    if not any(f.kind.name == "seconds" for f in drawn):
        absent.append("seconds of single trials (none was timed alone)")
    if not part.traces.learning and not group.is_grid and group.plane is None:
        absent.append("learning curves (not recorded)")
    return {
        "group": group, "facts": group_facts(group), "notes": notes, "absent": absent,
        "above": above, "figures": [f for f in here if not f.kind.recorded],
        "recorded": [f for f in here if f.kind.recorded],
        "why": [f for f in moved if f is not hero],
    }  # fmt: skip


def _provenance(evidence: Evidence) -> list[tuple[str, str]]:
    source = [o.provenance for o in evidence.outcomes]
    versions: dict[str, set[str]] = {}
    for entry in source:
        for name, value in dict(entry.get("versions") or {}).items():
            versions.setdefault(str(name), set()).add(str(value))
    machines = {" ".join(map(str, dict(e.get("machine") or {}).values())) for e in source}
    pairs = [
        ("trials made with", (f"{k} {' and '.join(sorted(v))}" for k, v in versions.items())),
        ("analysed with", (f"{name} {version(name)}" for name in PACKAGES)),
        ("machine", sorted(machines)),
        ("collectors", sorted({str(e.get("collector")) for e in source})),
        ("seeds of trials", sorted({str(e.get("seed")) for e in source})),
        ("caps", (f"{cap:,} iterations" for cap in sorted({o.cap for o in evidence.outcomes}))),
    ]
    return [(name, ", ".join(parts) or "not recorded") for name, parts in pairs]
