"""The results in sentences: the fastest strategy, significant differences, effects of options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trl_explore.names import strategy_label
from trl_explore.report.groups import Group
from trl_explore.report.questions import Confound, Question
from trl_explore.report.tables import FEW, MOST, figure, interval, listed, negated, some
from trl_explore.statistics.comparisons import Comparison
from trl_explore.statistics.estimates import LEVEL, pass_rate
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.power import trials_text
from trl_explore.thesis import FAILS, HOLDS, NOT_MEASURED, OPEN, Checked

BLOCKS = 4
"""Most blocks of a question that its sentence speaks of."""


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
    comparisons: Sequence[Comparison],
    configurations: Sequence[Outcomes],
    words: Mapping[str, str],
) -> str:
    did = _did(configurations)
    means = {c.name: float(c.durations.mean()) for c in configurations}
    passing = [c for c in configurations if c.converged.any()]
    if not passing:
        return f"no trial {did} under {some([words[c.name] for c in configurations])}"
    best, *rest = sorted(means, key=lambda name: means[name])
    equals = [words[n] for n in rest if _winner(best, n, comparisons) != best]
    second = rest[0]
    pair = next(c for c in comparisons if {c.a, c.b} == {best, second})
    fewer = interval(pair.difference if pair.a == second else negated(pair.difference))
    if means[best] == means[second]:
        alike = some([words[n] for n in means if means[n] == means[best]])
        return f"{alike} have the same mean, {means[best]:,.0f} iterations (difference {fewer})"
    last = f", and {words[rest[-1]]} {means[rest[-1]]:,.0f}" if len(rest) > 1 else ""
    if not equals:
        return (
            f"{words[best]} is fastest, {means[best]:,.0f} iterations, {fewer} fewer than"
            f" {words[second]}{last}"
        )
    others = "any other" if len(equals) == len(rest) > FEW else some(equals)
    return (
        f"{words[best]} has the smallest mean, {means[best]:,.0f} iterations, but is not"
        f" significantly faster than {others} ({fewer} fewer than {words[second]}){last}"
    )


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
        "Compared with nothing, because no other job has the same environment and stopping rule:"
        f" {some(names)}.",
    )


def option_sentences(
    comparisons: Sequence[Comparison], cells: Mapping[str, tuple[str, str]]
) -> tuple[str, ...]:
    """One sentence for each option: where it needs fewer or more iterations than the first option.

    ``comparisons`` are those of the first option with another in the same row, corrected together;
    ``cells`` has the labels of the (row, option) of each configuration.
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
                parts.append(f"{word} iterations under {some(rows)}")
        for same, text in (
            ("identical", "identical trials under"),
            ("neither passes", "no trial passes with either under"),
            ("", "no significant difference under"),
        ):
            rows = [row for row, c in found if c.winner is None and c.same == same]
            parts += [f"{text} {some(rows)}"] if rows else []
        sentences.append(f"{_capital(option)} against {first}: {'; '.join(parts)}.")
    return tuple(sentences)


def score_sentence(
    comparisons: Sequence[Comparison],
    scores: Sequence[Comparison],
    labels: Mapping[str, str],
    what: str = "final",
) -> str:
    """The pairs that differ in their scores although their iterations do not tell them apart.

    ``scores`` are the same pairs as ``comparisons``. Empty if there is no such pair.
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
    level: float = LEVEL,
) -> tuple[str, ...]:
    """State which points of a plane pass, which is fastest, and which beat the reference."""
    rates = [pass_rate(int(c.converged.sum()), len(c), level=level) for c in configurations]
    best = min(configurations, key=lambda c: float(c.durations.mean()))
    text = (
        f"Of {len(configurations)} points, {sum(r.above(0.8) for r in rates)} pass in more than"
        f" 80 % of trials and {sum(r.below(0.2) for r in rates)} in less than 20 % (intervals of"
        f" {100 * level:g} %). {_capital(labels[best.name])} has the smallest mean,"
        f" {best.durations.mean():.0f} iterations; as the best of many, it is optimistic."
    )
    if not comparisons:
        return (text,)
    faster = [c for c in comparisons if c.winner == c.b]
    slower = [c for c in comparisons if c.winner == c.a]
    named = f": {some([labels[c.b] for c in faster])}" if faster else ""
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
    level: float,
) -> str:
    if not configurations:
        return "No finished configuration was found."
    if len(configurations) == 1:
        only = configurations[0]
        passes = _passes(only, level)
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
        all_others = len(equals) == len(rivals) > FEW
        others = "any other" if all_others else some([name[c.name] for c in equals])
        return (
            f"No single configuration of {len(configurations)} is fastest: {name[best.name]}"
            f" has the smallest mean number of iterations, but does not differ significantly from"
            f" {others} at the {100 * level:g} % level."
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
        f" {_passes(best, level)}."
    )


def _differences(
    configurations: Sequence[Outcomes], comparisons: Sequence[Comparison], name: Mapping[str, str]
) -> str:
    failing = [name[c.name] for c in configurations if not c.converged.any()]
    never = f"{some(failing)} never {_did(configurations)}" if failing else ""
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
    if unclear and (real or len(unclear) <= FEW):
        more = f" and {len(unclear) - 3} more" if len(unclear) > 3 else ""
        text += f"; no significant difference between {'; '.join(unclear[:3])}{more}"
    return text + (f"; {never}." if never else ".")


def _winner(a: str, b: str, comparisons: Sequence[Comparison]) -> str | None:
    return next((c.winner for c in comparisons if {c.a, c.b} == {a, b}), None)


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


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:] if text[:1].isascii() else text  # ε has no capital
