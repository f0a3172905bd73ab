"""The results in sentences: the fastest strategy, significant differences, effects of options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trl_explore.report.tables import figure, interval, negated
from trl_explore.statistics.comparisons import Comparison
from trl_explore.statistics.estimates import LEVEL, pass_rate
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.power import trials_text
from trl_explore.thesis import FAILS, HOLDS, NOT_MEASURED, OPEN, Checked

MOST = 6
"""Most names that a sentence lists."""


def answer(
    configurations: Sequence[Outcomes],
    comparisons: Sequence[Comparison],
    *,
    labels: Mapping[str, str] | None = None,
) -> tuple[str, str]:
    """State which configuration converges fastest, and which differences are significant.

    A configuration is the fastest only if interval and corrected test exclude zero against every
    other one. If there is none, the sentence names all that do not differ significantly from the
    one with the smallest mean.

    Args:
        configurations: any number of configurations of one experiment.
        comparisons: ``compare_all`` of them; empty if they cannot be compared.
        labels: text to show instead of a configuration's name.

    Returns:
        Two sentences of plain text, not escaped.

    """
    name = {c.name: (labels or {}).get(c.name, c.name) for c in configurations}
    return (
        _fastest(configurations, comparisons, name),
        _differences(configurations, comparisons, name),
    )


def verdicts(checked: Sequence[Checked]) -> str:
    """State how many of the thesis's statements hold, do not hold, and are open."""
    measured = [c for c in checked if c.finding.verdict != NOT_MEASURED]
    if not measured:
        return "None of the thesis's statements could be checked with these data."
    by = {v: [c for c in checked if c.finding.verdict == v] for v in (HOLDS, FAILS, OPEN)}
    parts = [_count(len(by[HOLDS]), "holds", "hold")]
    refuted = [f"“{c.claim.statement.rstrip('.')}”" for c in by[FAILS]]
    more = f" and {len(refuted) - 3} more" if len(refuted) > 3 else ""
    examples = f" ({'; '.join(refuted[:3])}{more})" if refuted else ""
    parts.append(_count(len(refuted), "does not hold", "do not hold") + examples)
    needed = [c.finding.trials_needed for c in by[OPEN] if c.finding.trials_needed is not None]
    which = "it" if len(by[OPEN]) == 1 else "all that have an estimate"
    settle = f" (settling {which} takes {trials_text(max(needed))} trials)" if needed else ""
    still = "open at this number of trials"
    parts.append(_count(len(by[OPEN]), f"is {still}", f"are {still}") + settle)
    missing = len(checked) - len(measured)
    if missing:
        parts.append(_count(missing, "was not measured", "were not measured"))
    return f"Of the thesis's {len(checked)} statements, {_list(parts)}."


def option_sentences(
    comparisons: Sequence[Comparison], cells: Mapping[str, tuple[str, str]]
) -> tuple[str, ...]:
    """One sentence for each option: where it needs fewer or more iterations than the first option.

    Args:
        comparisons: the first option against another in the same row, corrected together.
        cells: name of a configuration -> labels of its (row, option).

    """
    by: dict[str, list[tuple[str, Comparison]]] = {}
    for c in comparisons:
        row, option = cells[c.b]
        by.setdefault(option, []).append((row, c))
    sentences = []
    for option, found in by.items():
        first = cells[found[0][1].a][1]
        parts = []
        for word, sign in (("fewer", 1), ("more", -1)):
            rows = [
                f"{row} ({sign * c.difference.value:,.0f})"
                for row, c in found
                if c.winner == (c.b if sign > 0 else c.a)
            ]
            if rows:
                parts.append(f"{word} iterations under {_some(rows)}")
        same = [r for r, c in found if _identical(c)]
        if same:
            parts.append(f"identical trials under {_some(same)}")
        never = [r for r, c in found if _never(c)]
        if never:
            parts.append(f"no trial passes with either under {_some(never)}")
        unclear = [r for r, c in found if c.winner is None and not _identical(c) and not _never(c)]
        if unclear:
            parts.append(f"no significant difference under {_some(unclear)}")
        sentences.append(f"{_capital(option)} against {first}: {'; '.join(parts)}.")
    return tuple(sentences)


def score_sentence(
    comparisons: Sequence[Comparison],
    scores: Sequence[Comparison],
    labels: Mapping[str, str],
    what: str = "final",
) -> str:
    """The pairs that differ in their scores although their iterations do not tell them apart.

    Args:
        comparisons: pairs compared by iterations.
        scores: the same pairs compared by scores.
        labels: name of a configuration -> label.
        what: the kind of score.

    Returns:
        One sentence; empty if there is no such pair.

    """
    undecided = {(c.a, c.b) for c in comparisons if c.winner is None}
    found = [c for c in scores if c.winner is not None and (c.a, c.b) in undecided]
    if not found:
        return ""
    found.sort(key=lambda c: -abs(c.difference.value))
    said = []
    for c in found[:MOST]:
        high, low = (c.a, c.b) if c.winner == c.a else (c.b, c.a)
        mean = {c.a: c.mean_a, c.b: c.mean_b}
        e = c.difference if c.winner == c.a else negated(c.difference)
        said.append(
            f"{labels[high]} {figure(mean[high])} against {labels[low]} {figure(mean[low])}"
            f" (difference {interval(e)})"
        )
    more = f"; and {len(found) - MOST} more pairs" if len(found) > MOST else ""
    return (
        f"The {what} scores differ significantly, after Holm’s correction, where the iterations do"
        f" not: {'; '.join(said)}{more}."
    )


def plane_sentences(
    configurations: Sequence[Outcomes],
    comparisons: Sequence[Comparison],
    labels: Mapping[str, str],
) -> tuple[str, ...]:
    """State which points of a plane pass, which is fastest, and which beat the reference."""
    rates = [pass_rate(int(c.converged.sum()), len(c)) for c in configurations]
    best = min(configurations, key=lambda c: float(c.durations.mean()))
    text = (
        f"Of {len(configurations)} points, {sum(r.above(0.8) for r in rates)} pass in more than"
        f" 80 % of trials and {sum(r.below(0.2) for r in rates)} in less than 20 % (intervals of"
        f" {100 * LEVEL:g} %). {_capital(labels[best.name])} has the smallest mean,"
        f" {best.durations.mean():.0f} iterations; as the best of many, it is optimistic."
    )
    if not comparisons:
        return (text,)
    faster = [c for c in comparisons if c.winner == c.b]
    slower = [c for c in comparisons if c.winner == c.a]
    named = f": {_some([labels[c.b] for c in faster])}" if faster else ""
    return (
        text,
        f"Against {labels[comparisons[0].a]}, the thesis’s softmax, {len(faster)} of"
        f" {len(comparisons)} points need significantly fewer iterations after Holm’s correction"
        f"{named}; {len(slower)} need significantly more.",
    )


def _fastest(
    configurations: Sequence[Outcomes],
    comparisons: Sequence[Comparison],
    name: Mapping[str, str],
) -> str:
    if not configurations:
        return "No finished configuration was found."
    if len(configurations) == 1:
        only = configurations[0]
        passes = _passes(only)
        return f"Only {name[only.name]} was run: {passes}. There is nothing to compare it to."
    passing = [c for c in configurations if c.converged.any()]
    if not passing:
        return (
            f"None of the {len(configurations)} configurations {_did(configurations)} in any trial."
        )
    if not comparisons:
        return (
            f"The {len(configurations)} configurations are not compared: they have different"
            " stopping rules or share trials."
        )
    best = min(passing, key=lambda c: float(c.durations.mean()))
    rivals = [c for c in configurations if c is not best]
    equals = [c for c in rivals if _winner(best.name, c.name, comparisons) != best.name]
    if equals:
        others = _list([name[c.name] for c in equals])
        return (
            f"No single configuration of {len(configurations)} is fastest: {name[best.name]}"
            f" has the smallest mean number of iterations, but does not differ significantly from"
            f" {others} at the {100 * LEVEL:g} % level."
        )
    second = min(rivals, key=lambda c: float(c.durations.mean()))
    margin = next(c for c in comparisons if {c.a, c.b} == {best.name, second.name})
    sign = 1.0 if margin.a == best.name else -1.0
    low, high = sorted(-sign * x for x in (margin.difference.low, margin.difference.high))
    return (
        f"{_capital(name[best.name])} {'learns' if best.measure == 'learned' else 'converges'}"
        f" fastest of {len(configurations)} configurations:"
        f" it needs {best.durations.mean():.0f} iterations on average (restricted to the cap of"
        f" {best.cap}), {-sign * margin.difference.value:.0f} fewer than the next,"
        f" {name[second.name]} ({100 * margin.difference.level:.3g} % interval {low:.0f} to"
        f" {high:.0f}), and"
        f" {_passes(best)}."
    )


def _differences(
    configurations: Sequence[Outcomes], comparisons: Sequence[Comparison], name: Mapping[str, str]
) -> str:
    failing = [name[c.name] for c in configurations if not c.converged.any()]
    never = f"{_list(failing)} never {_did(configurations)}" if failing else ""
    if not comparisons:
        return f"No differences were tested{f', and {never}' if never else ''}."
    real = [c for c in comparisons if c.winner is not None]
    n = min(min(c.n_a, c.n_b) for c in comparisons)
    what = "pair differs" if len(comparisons) == 1 else "pairs differ"
    text = (
        f"{len(real)} of {len(comparisons)} {what} significantly in iterations after Holm's"
        f" correction, with at least {n} trials per configuration"
    )
    unclear = [f"{name[c.a]} and {name[c.b]}" for c in comparisons if c.winner is None]
    if unclear:
        more = f" and {len(unclear) - 3} more" if len(unclear) > 3 else ""
        text += f"; no significant difference between {'; '.join(unclear[:3])}{more}"
    return text + (f"; {never}." if never else ".")


def _winner(a: str, b: str, comparisons: Sequence[Comparison]) -> str | None:
    return next((c.winner for c in comparisons if {c.a, c.b} == {a, b}), None)


def _passes(c: Outcomes) -> str:
    k, n = int(c.converged.sum()), len(c)
    if n == 0:
        return "it has no trials"
    rate = pass_rate(k, n)
    bounds = f"{100 * rate.low:.1f} to {100 * rate.high:.1f} %"
    verb = "learns" if c.measure == "learned" else "passes"
    return f"it {verb} in {k} of {n} trials ({100 * LEVEL:g} % interval {bounds})"


def _did(configurations: Sequence[Outcomes]) -> str:
    return "learned" if configurations[0].measure == "learned" else "passed"


def _identical(c: Comparison) -> bool:
    """Whether every trial took equally many iterations under both, and some converged."""
    return c.sd == 0 and c.difference.value == 0 and not _never(c)


def _never(c: Comparison) -> bool:
    return c.mean_a == c.mean_b == c.cap


def _some(words: Sequence[str]) -> str:
    return _list([*words[:MOST], f"{len(words) - MOST} more"] if len(words) > MOST else words)


def _list(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def _count(n: int, one: str, many: str) -> str:
    return f"{n} {one if n == 1 else many}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:] if text[:1].isascii() else text  # ε has no capital
