"""The results in sentences: the fastest strategy, significant differences, effects of options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import nan

from trl_explore.names import strategy_label
from trl_explore.report.groups import Group
from trl_explore.report.questions import Confound, Question
from trl_explore.report.table_formats import (
    FEW,
    MOST,
    capital,
    interval,
    listed,
    negated,
    rounded,
    some,
)
from trl_explore.statistics.comparisons import Comparison, too_few
from trl_explore.statistics.estimates import LEVEL, Estimate, pass_rate
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.power import trials_text
from trl_explore.thesis import FAILS, HOLDS, NOT_MEASURED, OPEN, Checked

BLOCKS = 4
"""The most blocks of a question in its sentence."""


def answer(
    configurations: Sequence[Outcomes],
    comparisons: Sequence[Comparison],
    *,
    labels: Mapping[str, str] | None = None,
    level: float = LEVEL,
) -> tuple[str, ...]:
    """State which configuration converges fastest, and which differences are significant.

    A configuration is the fastest only if interval and corrected test exclude zero against every
    other one. If there is none, the sentence names all that do not differ significantly from the
    one with the smallest mean.

    Args:
        configurations: any number of configurations of one experiment.
        comparisons: ``compare_all`` of them; empty if they cannot be compared.
        labels: text to show instead of a configuration's name.
        level: confidence level.
    """
    name = {c.name: (labels or {}).get(c.name, c.name) for c in configurations}
    first = _fastest(configurations, comparisons, name, level)
    if len(configurations) > 1 and not any(c.converged.any() for c in configurations):
        return (first,)
    return first, _differences(configurations, comparisons, name)


def verdicts(checked: Sequence[Checked], whose: str = "thesis") -> tuple[str, ...]:
    """State how many of the statements hold, do not hold, and are open; nothing if none applies."""
    measured = [c for c in checked if c.finding.verdict != NOT_MEASURED]
    if not measured:
        return ()
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
    many = "statement" if len(checked) == 1 else "statements"
    return (f"Of the {whose}'s {len(checked)} {many}, {listed(parts)}.",)


def question_sentence(
    question: Question, comparisons: Sequence[Comparison], by_name: Mapping[str, Outcomes]
) -> str:
    """The effect of a factor in each block of configurations that agree in everything else.

    The block with the largest significant difference comes first.
    """
    said = []
    for block in question.blocks:
        own = [c for c in comparisons if c.a in block.names and c.b in block.names]
        real = [abs(c.difference.value) for c in own if c.winner is not None]
        words = {name: question.word(name) for name in block.names}
        text = _block(own, [by_name[n] for n in block.names], words)
        said.append((-max(real, default=0.0), f"{block.where}: {text}" if block.where else text))
    texts = [text for _, text in sorted(said, key=lambda pair: pair[0])]
    more = f"; and {len(texts) - BLOCKS} more" if len(texts) > BLOCKS else ""
    return f"The effect of {question.of}: {'; '.join(texts[:BLOCKS])}{more}."


def _block(
    comparisons: Sequence[Comparison], configurations: Sequence[Outcomes], words: Mapping[str, str]
) -> str:
    if not any(c.converged.any() for c in configurations):
        names = some([words[c.name] for c in configurations])
        return f"no trial {_did(configurations)} under {names}"
    best, rest, equals, fewer = _ranked(configurations, comparisons)
    mean = f"{best.durations.mean():,.0f} iterations"
    if best.durations.mean() == rest[0].durations.mean():
        alike = some([words[c.name] for c in configurations
                      if c.durations.mean() == best.durations.mean()])  # fmt: skip
        return f"{alike} have the same mean, {mean} (difference {interval(fewer)})"
    last = ""
    if len(rest) > 1:
        last = f", and {words[rest[-1].name]} {rest[-1].durations.mean():,.0f}"
    saved = f"{interval(fewer)} fewer than {words[rest[0].name]}"
    if not equals:
        return f"{words[best.name]} is fastest, {mean}, {saved}{last}"
    others = "any other" if len(equals) == len(rest) > FEW else some([words[n] for n in equals])
    return (
        f"{words[best.name]} has the smallest mean, {mean}, but is not significantly faster than"
        f" {others} ({saved}){last}"
    )


def _ranked(
    configurations: Sequence[Outcomes], comparisons: Sequence[Comparison]
) -> tuple[Outcomes, list[Outcomes], list[str], Estimate]:
    """The best, the others by their mean, those not beaten, and what the best saves on the next.

    What it saves is NaN if that pair was not compared.
    """
    best, *rest = sorted(configurations, key=lambda c: (c.durations.mean(), not c.converged.any()))
    pairs = {frozenset((c.a, c.b)): c for c in comparisons}
    found = {c.name: pairs.get(frozenset((best.name, c.name))) for c in rest}
    equals = [name for name, c in found.items() if c is None or c.winner != best.name]
    fewer = Estimate(nan, nan, nan)
    if (pair := found[rest[0].name]) is not None:
        fewer = pair.difference if pair.b == best.name else negated(pair.difference)
    return best, rest, equals, fewer


def confounded_sentence(confound: Confound, group: Group) -> str:
    """What cannot be separated, and the jobs that would separate it."""
    by_name = {c.name: c for c in group.configurations}
    called = [f"“{group.labels[name]}”" for name in confound.names]
    passed = [f"{int(c.converged.sum())} of {len(c)}" for c in (by_name[n] for n in confound.names)]
    text = (
        f"{some(called)} differ in {listed(confound.factors)} at once, so these are confounded: no"
        f" difference between them can be ascribed to one of the {len(confound.factors)}"
        f" ({_did(group.configurations)}: {', '.join(passed[:MOST])} trials)."
    )
    if not confound.commands:
        return f"{text} Jobs that change one of these at a time would separate them."
    runs = listed([f"`{command}`" for command in confound.commands[:3]])
    return f"{text} To separate them, also run {runs}."


def alone(groups: Sequence[Group]) -> tuple[str, ...]:
    """The configurations that nothing can be compared with; empty for none."""
    names = [
        f"{strategy_label(g.configurations[0].strategy)} ({g.environment}, cap {g.cap:,}:"
        f" {int(g.configurations[0].converged.sum())} of {len(g.configurations[0])} trials"
        f" {_did(g.configurations)})"
        for g in groups
    ]
    if not names:
        return ()
    return (
        "Not compared, because no other job has the same environment and stopping rule:"
        f" {some(names)}.",
    )


def score_sentence(
    comparisons: Sequence[Comparison] | None, scores: Sequence[Comparison], group: Group
) -> tuple[str, ...]:
    """The pairs that differ in their scores although their iterations do not tell them apart.

    ``scores`` are the same pairs as ``comparisons``; without these, all that differ. Nothing if
    there is no such pair.
    """
    what, labels = "learned" if group.did == "learned" else "final", group.labels
    decided = {(c.a, c.b) for c in comparisons or () if c.winner is not None}
    found = [c for c in scores if c.winner is not None and (c.a, c.b) not in decided]
    if not found:
        if comparisons is None and scores:
            pairs = _count(len(scores), "pair", "pairs")
            return (f"No {what} scores differ significantly in {pairs}.",)
        return ()
    found.sort(key=lambda c: -abs(c.difference.value))
    said = []
    for c in found[:MOST]:
        high, low = (c.a, c.b) if c.winner == c.a else (c.b, c.a)
        mean = {c.a: c.mean_a, c.b: c.mean_b}
        e = c.difference if c.winner == c.a else negated(c.difference)
        said.append(
            f"{labels[high]} {rounded(mean[high])} against {labels[low]} {rounded(mean[low])}"
            f" (difference {interval(e)})"
        )
    more = f"; and {len(found) - MOST} more pairs" if len(found) > MOST else ""
    return (
        f"The {what} scores differ significantly, after Holm’s correction"
        f"{'' if comparisons is None else ', where the iterations do not'}:"
        f" {'; '.join(said)}{more}.",
    )


def warning(group: Group, comparisons: Sequence[Comparison], level: float) -> tuple[str, ...]:
    """Why no trial could pass, or no difference could be significant; otherwise nothing."""
    if all(c.cut_short for c in group.configurations):
        return (
            f"No trial could pass: the cap of {group.cap:,} iterations ends it before it has"
            f" played the {group.window:,} episodes that the score is averaged over.",
        )
    if (fewest := too_few(comparisons, level=level)) is None:
        return ()
    n, tests = max(min(c.n_a, c.n_b) for c in comparisons), len(comparisons)
    corrected = f", corrected for {tests} comparisons," if tests > 1 else ""
    return (
        f"There may still be large differences: {n} trials are too few for any significant result."
        f" The test{corrected} needs at least {fewest} trials of each configuration, even if the"
        " difference is the same in every trial.",
    )


def _fastest(
    configurations: Sequence[Outcomes],
    comparisons: Sequence[Comparison],
    name: Mapping[str, str],
    level: float,
) -> str:
    count = len(configurations)
    if count == 0:
        return "No finished configuration was found."
    if count == 1:
        (only,) = configurations
        return (
            f"Only {name[only.name]} was run: {_passes(only, level)}. There is nothing to compare"
            " it to."
        )
    if not any(c.converged.any() for c in configurations):
        return f"None of the {count} configurations {_did(configurations)} in any trial."
    if not comparisons:
        return (
            f"The {count} configurations are not compared: they have different stopping rules or"
            " share trials."
        )
    best, rest, equals, fewer = _ranked(configurations, comparisons)
    if equals:
        others = [name[c.name] for c in configurations if c.name in equals]
        return (
            f"No single configuration of {count} is fastest: {name[best.name]} has the smallest"
            " mean number of iterations, but does not differ significantly from"
            f" {'any other' if len(equals) == len(rest) > FEW else some(others)}"
            f" at the {100 * level:g} % level."
        )
    return (
        f"{capital(name[best.name])} {'learns' if best.measure == 'learned' else 'converges'}"
        f" fastest of {count} configurations:"
        f" it needs {best.durations.mean():.0f} iterations on average (restricted to the cap of"
        f" {best.cap}), {fewer.value:.0f} fewer than the next, {name[rest[0].name]}"
        f" ({100 * fewer.level:.3g} % interval {fewer.low:.0f} to {fewer.high:.0f}), and"
        f" {_passes(best, level)}."
    )


def _differences(
    configurations: Sequence[Outcomes], comparisons: Sequence[Comparison], name: Mapping[str, str]
) -> str:
    failing = [name[c.name] for c in configurations if not c.converged.any()]
    never = f"{some(failing)} never {_did(configurations)}" if failing else ""
    if not comparisons:
        return f"No differences were tested{f', and {never}' if never else ''}."
    real = sum(c.winner is not None for c in comparisons)
    text = (
        f"{real} of {_count(len(comparisons), 'pair differs', 'pairs differ')} significantly in"
        " iterations after Holm's correction, with at least"
        f" {min(min(c.n_a, c.n_b) for c in comparisons)} trials per configuration"
    )
    unclear = [f"{name[c.a]} and {name[c.b]}" for c in comparisons if c.winner is None]
    if unclear and (real or len(unclear) <= FEW):
        more = f" and {len(unclear) - 3} more" if len(unclear) > 3 else ""
        text += f"; no significant difference between {'; '.join(unclear[:3])}{more}"
    return text + (f"; {never}." if never else ".")


def _passes(c: Outcomes, level: float) -> str:
    k, n = int(c.converged.sum()), len(c)
    if n == 0:
        return "it has no trials"
    rate = pass_rate(k, n, level=level)
    bounds = f"{100 * rate.low:.1f} to {100 * rate.high:.1f} %"
    verb = "learns" if c.measure == "learned" else "passes"
    return f"it {verb} in {k} of {n} trials ({100 * level:g} % interval {bounds})"


def _did(configurations: Sequence[Outcomes]) -> str:
    return "learned" if configurations[0].measure == "learned" else "passed"


def _count(n: int, one: str, many: str) -> str:
    return f"{n} {one if n == 1 else many}"
