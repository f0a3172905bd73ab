"""Setup and methods: the settings of a study, a paragraph for a paper, and what to cite."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from importlib.metadata import version
from importlib.resources import files
from typing import Any

from trl_explore.report.evidence import Evidence
from trl_explore.report.factors import settings_of
from trl_explore.report.groups import Group
from trl_explore.report.table_formats import Column, Record, Table, listed
from trl_explore.statistics.outcomes import Outcomes

MOST_VALUES = 8
"""Most values of a setting that the table lists."""
RULES = ("environment", "cap", "threshold", "window", "stops by", "trials", "seeds")

CITED: Mapping[str, Callable[[Evidence], bool]] = {
    "trl_explore": lambda e: True,
    "williams1992": lambda e: True,
    "sutton2018": lambda e: _uses(e, r"epsilon|softmax|argmax|greedy"),
    "bou2024": lambda e: True,
    "towers2024": lambda e: True,
    "kaplan1958": lambda e: True,
    "royston2013": lambda e: True,
    "wilson1927": lambda e: True,
    "zou2008": lambda e: True,
    "holm1979": lambda e: any(len(p.comparisons) > 1 for p in e.groups),
    "mantel1966": lambda e: any(p.comparisons for p in e.groups),
    "agarwal2021": lambda e: True,
    "fieller1954": lambda e: bool(e.decompositions),
    "clopper1934": lambda e: bool(e.checked),
    "kingma2015": lambda e: _setting(e, "optimiser", "Adam"),
    "glorot2010": lambda e: _setting(e, "policy", "glorot"),
    "barto1983": lambda e: _setting(e, "environment", "CartPole"),
    "precup2000": lambda e: _setting(e, "correction", "per-|trajectory"),
    "tokic2010": lambda e: _uses(e, "vdbe"),
    "dabney2021": lambda e: _uses(e, "epsilon_z"),
    "plappert2018": lambda e: _uses(e, "parameter_noise"),
    "osband2020": lambda e: _setting(e, "environment", "DeepSea|Catch"),
}
"""Key of ``references.bib`` -> whether a study uses it."""


def settings(evidence: Evidence) -> dict[str, list[str]]:
    """Setting -> its values in the study, those that are the same everywhere last."""
    found: dict[str, list[str]] = {}
    configurations = [c for part in evidence.groups for c in part.group.configurations]
    for c in configurations:
        for label, value in (settings_of(c) | _rule(c)).items():
            if value not in found.setdefault(label, []):
                found[label].append(value)
    first = dict.fromkeys((*RULES, "strategy", "policy"))
    ordered = [label for label in first if label in found] + [x for x in found if x not in first]
    return {x: found[x] for x in sorted(ordered, key=lambda label: len(found[label]) < 2)}


def settings_table(evidence: Evidence) -> Table:
    """One row per setting: whether it varies, and its values."""
    records = [
        {"setting": label, "varies": len(values) > 1, "values": "; ".join(values)}
        for label, values in settings(evidence).items()
    ]

    def shown(r: Record) -> str:
        values = r["values"].split("; ")
        more = f"; and {len(values) - MOST_VALUES} more" if len(values) > MOST_VALUES else ""
        return "; ".join(values[:MOST_VALUES]) + more

    columns = [
        Column("setting", "setting", lambda r: r["setting"]),
        Column("varies", "varies", lambda r: "varies" if r["varies"] else "the same"),
        Column("values", "value", shown, wide=True),
    ]
    return Table("settings", "Settings", columns, records, main=True)


def paragraph(evidence: Evidence) -> str:
    """The methods of the study in sentences with numbers, ready for a paper."""
    known = settings(evidence)
    trials = sum(len(c) for p in evidence.groups for c in p.group.configurations)
    frames = sum(s.frames_total for p in evidence.groups for s in p.summaries)
    count = sum(len(p.group.configurations) for p in evidence.groups)
    level = f"{100 * evidence.study.level:g} %"
    same = {label: values[0] for label, values in known.items() if len(values) == 1}
    varied = list(dict.fromkeys(f.label for p in evidence.groups for f in p.group.factors))
    where = listed(list(dict.fromkeys(p.group.environment for p in evidence.groups)))
    agent = [
        f"{text.format(same[label])}"
        for label, text in {
            "strategy": "the strategy was {}", "policy": "the policy was a {}",
            "baseline": "the baseline was {}", "correction": "the gradient was {}",
            "optimiser": "the optimiser was {}", "learning rate": "the learning rate was {}",
            "γ": "γ = {}",
        }.items()
        if label in same
    ]  # fmt: skip
    places = {p.group.environment for p in evidence.groups}
    rules = list(dict.fromkeys(
        f"{_success(p.group)} {p.group.threshold:g}"
        f"{f' on {p.group.environment}' if len(places) > 1 else ''}"
        f" (cap: {p.group.cap:,} iterations)"
        for p in evidence.groups
    ))  # fmt: skip
    did = evidence.groups[0].group.did
    seeds = dict.fromkeys(seed for text in known["seeds"] for seed in text.split(", "))
    pairs = any(c.design == "paired" for p in evidence.groups for c in p.comparisons)
    paired = " and are compared in pairs" if pairs else ""
    tested = sum(len(p.comparisons) for p in evidence.groups)
    names = {k: v for o in evidence.outcomes for k, v in _versions(o).items()}
    used = [f"{name} {names[name]}" for name in ("trl_explore", "torch", "torchrl", "gymnasium")
            if name in names]  # fmt: skip
    return " ".join(
        [
            f"We trained {trials:,} independent agents ({count} configurations,"
            f" {frames:,} environment steps) on {where} with REINFORCE (Williams, 1992).",
            f"In all of them, {listed(agent)}.".replace("the baseline was no", "there was no")
            if agent
            else "",
            f"The configurations differed in {listed(varied)}." if varied else "",
            f"An agent {did} when {' or '.join(rules)}; agents that had not {did} at the cap are"
            " right-censored.",
            f"Agents of the same seed and index (seeds: {', '.join(seeds)}) share initial"
            f" weights and random streams under every configuration{paired}.",
            f"Shares have Wilson intervals at the {level} level; mean times are restricted to the"
            " cap and have intervals by the method of variance estimates recovery (Zou & Donner,"
            " 2008); survival curves are Kaplan–Meier estimates.",
            f"The {tested} comparisons were corrected by Holm’s method within each question."
            if tested > 1
            else "One pair was compared."
            if tested
            else "No configurations were compared.",
            f"Software: {', '.join(used)}." if used else "",
        ]
    ).replace("  ", " ")


def references(evidence: Evidence) -> str:
    """The entries of ``references.bib`` that the study used, as BibTeX."""
    text = files("trl_explore.report").joinpath("references.bib").read_text(encoding="utf-8")
    entries = {m[1]: m[0] for m in re.finditer(r"@\w+\{(\w+),.*?\n\}\n", text, re.S)}
    used = (entries[key] for key, applies in CITED.items() if applies(evidence))
    return "\n".join(used).replace("@VERSION@", version("trl_explore"))


def _rule(c: Outcomes) -> dict[str, str]:
    seeds = sorted(set(c.seed.tolist()))
    return {
        "cap": f"{c.cap:,} iterations",
        "threshold": f"{c.threshold:g}",
        "window": f"{c.window} episodes",
        "stops by": str(c.config.get("stop_on", "training")),
        "trials": f"{len(c):,}",
        "seeds": ", ".join(map(str, seeds)),
    }


def _success(group: Group) -> str:
    if group.did == "learned":
        return "fresh episodes, played without the strategy, confirmed a mean score above"
    return f"its mean score over the last {group.window} episodes exceeded"


def _versions(o: Outcomes) -> Mapping[str, Any]:
    return dict(o.provenance.get("versions") or {})


def _uses(evidence: Evidence, pattern: str) -> bool:
    return any(re.search(pattern, o.strategy) for o in evidence.outcomes)


def _setting(evidence: Evidence, label: str, pattern: str) -> bool:
    return any(re.search(pattern, value) for value in settings(evidence).get(label, ()))
