"""The answer to *why* in three sentences: acting, bias, data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trl_explore.report.decomposition import Decomposition, Parts
from trl_explore.report.numbers import figure, interval, percent
from trl_explore.statistics.estimates import Estimate


def headline(found: Sequence[Decomposition]) -> tuple[str, ...]:
    """One sentence each on acting, bias and data, for the strategies of the first environment.

    A sentence is missing if nothing of its kind was measured.
    """
    if not found:
        return ()
    first = [d for d in found if d.environment == found[0].environment]
    return tuple(s for s in (_acting(first), _bias(first), _data(first)) if s)


def _acting(found: Sequence[Decomposition]) -> str:
    known = [(d.strategy, d.acting["plain"]) for d in found if "plain" in d.acting]
    if not known:
        return ""
    known += [("softmax", a) for d in found[:1] if (a := d.acting.get("reference"))]
    first, *others = known
    said = [
        f"{first[0]} scores {figure(first[1].behaved.value)} with its exploration and"
        f" {figure(first[1].learned.value)} without it",
        *(f"{name} {figure(a.behaved.value)} and {figure(a.learned.value)}" for name, a in others),
    ]
    return (
        "Acting: an agent’s score while it explores is not what it has learned. With the same"
        f" weights, as a mean over training, {'; '.join(said)}."
    )


def _bias(found: Sequence[Decomposition]) -> str:
    said = []
    for d in found:
        p = _time(d)
        if p is None:
            continue
        if np.isnan(p.bias.value):
            said.append(
                f"nothing clear of {d.strategy}, which hardly differs from softmax"
                f" ({interval(p.gap)} iterations)"
            )
        else:
            said.append(
                f"{percent(p.bias)} of the {figure(abs(p.gap.value))} iterations that {d.strategy}"
                f" needs {'more' if p.gap.value > 0 else 'less'} than softmax"
                f" ({figure(p.plain)} against {figure(p.reference)})"
            )
    if not said:
        return ""
    what = "learn" if any("learning" in d.parts for d in found) else "pass"
    return (
        "Bias: a gradient that treats the actions as if they came from the policy is biased; of the"
        f" time to {what}, this explains {'; '.join(said)}."
    )


def _data(found: Sequence[Decomposition]) -> str:
    said = []
    for d in found:
        p = d.parts.get("learning")
        if p is None or p.data is None:
            continue
        if p.told_apart:
            more = "more" if p.data.value > 0 else "fewer"
            low, high = sorted((abs(p.data.low), abs(p.data.high)))
            size = interval(Estimate(abs(p.data.value), low, high))
            said.append(f"{d.strategy} needs {size} iterations {more} than softmax")
        else:
            said.append(
                f"{d.strategy} does not differ significantly ({interval(p.data)} iterations)"
            )
    if not said:
        return ""
    return (
        "Data: what is left when every gradient is corrected is the effect of exploration proper."
        f" To learn, {'; '.join(said)}."
    )


def _time(d: Decomposition) -> Parts | None:
    return d.parts.get("learning") or d.parts.get("passing")
