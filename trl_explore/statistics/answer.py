"""The answer in three sentences, generated from comparisons and verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trl_explore.statistics.comparisons import Comparison
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.proportions import pass_rate
from trl_explore.thesis.model import FAILS, HOLDS, NOT_MEASURED, OPEN, Checked


def answer(
    configurations: Sequence[Outcomes],
    comparisons: Sequence[Comparison],
    checked: Sequence[Checked],
    *,
    labels: Mapping[str, str] | None = None,
) -> tuple[str, str, str]:
    """State who converges fastest, which differences are real, and how the thesis fares.

    Nobody is called fastest because of a mean: a configuration leads where interval and
    corrected test exclude zero against every other one, and else shares the first place with
    those it cannot be told apart from.

    Args:
        configurations: the configurations of one experiment, any number.
        comparisons: ``compare_all`` of them; empty where they cannot be compared.
        checked: ``check_claims`` of the study; empty where none was asked.
        labels: what to call a configuration instead of its name.

    Returns:
        Three sentences, plain text that is not escaped.

    """
    name = {c.name: (labels or {}).get(c.name, c.name) for c in configurations}
    return (
        _fastest(configurations, comparisons, name),
        _differences(configurations, comparisons, name),
        _thesis(checked),
    )


def because(causes: Sequence[Checked]) -> str:
    """State whether it is exploration that tells the strategies apart, or a biased gradient.

    A strategy that acts by another policy μ than the one that learns, π, also has a gradient that
    is that of neither.

    Args:
        causes: the checked statements on what the bias explains.

    Returns:
        A sentence; empty where none of the statements was measured.

    """
    words = {HOLDS: "this holds", FAILS: "this does not hold", OPEN: "this is open"}
    said = [
        f"“{c.claim.statement.rstrip('.')}”: {words[c.finding.verdict]}"
        for c in causes
        if c.finding.verdict in words
    ]
    if not said:
        return ""
    return (
        "Exploration is not all that differs: an agent that acts by another policy than the one"
        f" it learns follows a gradient that belongs to neither. {'; '.join(said)}."
    )


def _fastest(
    configurations: Sequence[Outcomes], comparisons: Sequence[Comparison], name: dict[str, str]
) -> str:
    if not configurations:
        return "No finished configuration was found, so that nothing can be said."
    if len(configurations) == 1:
        only = configurations[0]
        return f"Only {name[only.name]} was run: {_passes(only)}, with nothing to compare it to."
    passing = [c for c in configurations if c.converged.any()]
    if not passing:
        return f"None of the {len(configurations)} configurations passed in any trial."
    if not comparisons:
        return (
            f"The {len(configurations)} configurations were stopped by different rules or share"
            " their trials, so that they are not compared."
        )
    best = min(passing, key=lambda c: float(c.durations.mean()))
    rivals = [c for c in configurations if c is not best]
    level = comparisons[0].difference.level
    equals = [c for c in rivals if _winner(best.name, c.name, comparisons) != best.name]
    if equals:
        others = _list([name[c.name] for c in equals])
        return (
            f"No single configuration of {len(configurations)} is fastest: {name[best.name]}"
            f" cannot be told apart from {others} in iterations to convergence"
            f" at the {100 * level:g} % level."
        )
    second = min(rivals, key=lambda c: float(c.durations.mean()))
    margin = next(c for c in comparisons if {c.a, c.b} == {best.name, second.name})
    sign = 1.0 if margin.a == best.name else -1.0
    low, high = sorted(-sign * x for x in (margin.difference.low, margin.difference.high))
    return (
        f"{_capital(name[best.name])} converges fastest of {len(configurations)} configurations:"
        f" it needs {best.durations.mean():.0f} iterations on average (counted to the cap of"
        f" {best.cap}), {-sign * margin.difference.value:.0f} fewer than the next,"
        f" {name[second.name]} ({100 * level:g} % interval {low:.0f} to {high:.0f}), and"
        f" {_passes(best)}."
    )


def _differences(
    configurations: Sequence[Outcomes], comparisons: Sequence[Comparison], name: dict[str, str]
) -> str:
    failing = [name[c.name] for c in configurations if not c.converged.any()]
    never = f"{_list(failing)} never passed" if failing else ""
    if not comparisons:
        return f"No differences were tested{f', and {never}' if never else ''}."
    real = [c for c in comparisons if c.winner is not None]
    n = min(min(c.n_a, c.n_b) for c in comparisons)
    what = "pair differs" if len(comparisons) == 1 else "pairs differ"
    text = (
        f"{len(real)} of {len(comparisons)} {what} in iterations beyond chance after Holm's"
        f" correction, with {n} trials or more per configuration"
    )
    unclear = [f"{name[c.a]} and {name[c.b]}" for c in comparisons if c.winner is None]
    if unclear:
        more = f" and {len(unclear) - 3} more" if len(unclear) > 3 else ""
        text += f"; not told apart: {'; '.join(unclear[:3])}{more}"
    return text + (f"; {never}." if never else ".")


def _thesis(checked: Sequence[Checked]) -> str:
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
    which = "it" if len(by[OPEN]) == 1 else "the last of those that can be computed"
    settle = f" (to settle {which} takes {max(needed):,} of each configuration)" if needed else ""
    still = "open at this number of trials"
    parts.append(_count(len(by[OPEN]), f"is {still}", f"are {still}") + settle)
    missing = len(checked) - len(measured)
    if missing:
        parts.append(_count(missing, "was not measured", "were not measured"))
    return f"Of the thesis's {len(checked)} statements {_list(parts)}."


def _winner(a: str, b: str, comparisons: Sequence[Comparison]) -> str | None:
    return next((c.winner for c in comparisons if {c.a, c.b} == {a, b}), None)


def _passes(c: Outcomes) -> str:
    k, n = int(c.converged.sum()), len(c)
    if n == 0:
        return "it has no trials"
    rate = pass_rate(k, n)
    bounds = f"{100 * rate.low:.1f} to {100 * rate.high:.1f} %"
    return f"it passes in {k} of {n} trials (95 % interval {bounds})"


def _list(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def _count(n: int, one: str, many: str) -> str:
    return f"{n} {one if n == 1 else many}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:] if text[:1].isascii() else text  # ε has no capital
