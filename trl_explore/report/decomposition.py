"""Why strategies differ: acting, the bias of the gradient, and the data.

For every strategy that was run beside softmax, three questions:

* *acting*: how much of its score in training is lost to its own exploration? The same weights are
  played with and without it.
* *bias*: how much of what it learns later, or less, is due to the bias of its gradient? Either the
  gradient is corrected on its own data (per-step ratio), or softmax gets the same bias on the data
  of softmax (``correction=as_if``).
* *data*: what is left between corrected strategies, judged by what was learned?
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trl_explore.report.cells import Crossing, Run, Values, crossings
from trl_explore.statistics.comparisons import holm
from trl_explore.statistics.decomposition import Cells, aligned, mean_of, p_of_mean, share_of
from trl_explore.statistics.estimates import LEVEL, Estimate
from trl_explore.statistics.pairing import trial_keys

QUANTITIES: Mapping[str, str] = {
    "learning": "iterations to learning",
    "height": "mean learned score over training",
    "learned_score": "final learned score",
    "passing": "iterations to passing",
    "behaved": "mean score in training",
}
"""Quantity of a trial -> its name. The first three describe what was learned."""


@dataclass(frozen=True)
class Acting:
    """The same weights with and without exploration; means over a trial's training.

    Attributes:
        behaved: the mean score with exploration.
        learned: the mean score without.
        handicap: learned − behaved.
    """

    behaved: Estimate
    learned: Estimate
    handicap: Estimate


@dataclass(frozen=True)
class Parts:
    """The difference between a strategy and softmax in one quantity, and its parts.

    A share is NaN, "not estimable", if the interval of the whole difference contains 0.

    Attributes:
        quantity: a key of ``QUANTITIES``.
        n: the number of trials that all cells have in common.
        reference: mean of softmax.
        plain: mean of the strategy, uncorrected.
        gap: plain − reference.
        assumed: share of the bias in the gap on the data of softmax; None if not run.
        corrected: share of the bias in the gap on the data of the strategy; None if not run.
        bias: the mean of both, or the only one.
        data: corrected − reference; None if the strategy was not run corrected.
        p_data: p-value of ``data`` (paired t test), after Holm's correction over the strategies.
    """

    quantity: str
    n: int
    reference: float
    plain: float
    gap: Estimate
    assumed: Estimate | None
    corrected: Estimate | None
    bias: Estimate
    data: Estimate | None
    p_data: float | None

    @property
    def told_apart(self) -> bool:
        """Whether interval and test show an effect of the data."""
        if self.data is None or self.p_data is None:
            return False
        return self.p_data <= 1.0 - LEVEL and self.data.outside(0.0, 0.0)


@dataclass(frozen=True)
class Decomposition:
    """The answers for one strategy in one environment.

    Attributes:
        environment: id of the environment.
        strategy: label of the strategy.
        name: its name in files.
        acting: cell -> the same weights with and without exploration; empty without evaluations.
        acting_share: share of the acting in the difference of the mean scores in training.
        parts: quantity -> its parts.
        passes: trials that pass uncorrected, and corrected, and their number; None if not run.
    """

    environment: str
    strategy: str
    name: str
    acting: Mapping[str, Acting]
    acting_share: Estimate | None
    parts: Mapping[str, Parts]
    passes: tuple[int, int, int] | None


def decompose(runs: Sequence[Run]) -> list[Decomposition]:
    """The decompositions of all strategies that the runs of a report allow, in their order."""
    found = []
    for c in crossings(runs):
        parts = {q: p for q in QUANTITIES if (p := _parts(q, c)) is not None}
        if parts:
            found.append(
                Decomposition(
                    environment=c.plain.environment,
                    strategy=c.label,
                    name=c.plain.passed.strategy,
                    acting={k: a for k, run in c.cells.items() if (a := _acting(run))},
                    acting_share=_acting_share(c),
                    parts=parts,
                    passes=_passes(c),
                )
            )
    return _with_holm(found)


def _parts(quantity: str, crossing: Crossing) -> Parts | None:
    """The parts of one quantity; None if a cell that is needed lacks it, or no trial is common."""
    cells = _cells(quantity, crossing)
    if cells is None or not cells.paths():
        return None
    data, p = None, None
    if cells.corrected is not None:
        change = cells.corrected - cells.reference
        data, p = mean_of(change), p_of_mean(change)
    return Parts(
        quantity=quantity,
        n=len(cells.gap),
        reference=float(cells.reference.mean()),
        plain=float(cells.plain.mean()),
        gap=mean_of(cells.gap),
        assumed=_path(cells.assumed, cells.reference, cells.gap),
        corrected=_path(cells.plain, cells.corrected, cells.gap),
        bias=share_of(cells.bias, cells.gap),
        data=data,
        p_data=p,
    )


def _cells(quantity: str, crossing: Crossing) -> Cells | None:
    found: dict[str, Values] = {}
    for name, run in crossing.cells.items():
        if (values := run.values().get(quantity)) is not None:
            found[name] = values
    if not {"reference", "plain"} <= found.keys():
        return None
    arrays = aligned([keys for keys, _ in found.values()], [x for _, x in found.values()])
    return Cells(**dict(zip(found, arrays, strict=True))) if len(arrays[0]) > 1 else None


def _path(
    more: NDArray[np.float64] | None, less: NDArray[np.float64] | None, gap: NDArray[np.float64]
) -> Estimate | None:
    return None if more is None or less is None else share_of(more - less, gap)


def _acting(run: Run) -> Acting | None:
    if run.heights is None:
        return None
    behaved, learned = run.heights.behaved, run.heights.evaluated
    return Acting(mean_of(behaved), mean_of(learned), mean_of(learned - behaved))


def _acting_share(crossing: Crossing) -> Estimate | None:
    pair = Crossing(crossing.label, crossing.reference, crossing.plain, None, None)
    behaved, handicap = _cells("behaved", pair), _cells("handicap", pair)
    if behaved is None or handicap is None:
        return None
    return share_of(-handicap.gap, behaved.gap)


def _passes(crossing: Crossing) -> tuple[int, int, int] | None:
    if crossing.corrected is None:
        return None
    both = [crossing.plain.passed, crossing.corrected.passed]
    values = [o.converged.astype(np.float64) for o in both]
    plain, corrected = aligned([trial_keys(o) for o in both], values)
    return int(plain.sum()), int(corrected.sum()), len(plain)


def _with_holm(found: Sequence[Decomposition]) -> list[Decomposition]:
    """The p-values of the data, corrected over the strategies of an environment."""
    result = list(found)
    for environment in dict.fromkeys(d.environment for d in found):
        for quantity in QUANTITIES:
            tested = {
                k: p
                for k, d in enumerate(found)
                if d.environment == environment
                and (part := d.parts.get(quantity)) is not None
                and (p := part.p_data) is not None
            }
            for k, p in zip(tested, holm(list(tested.values())), strict=True):
                parts = result[k].parts
                part = replace(parts[quantity], p_data=p)
                result[k] = replace(result[k], parts={**parts, quantity: part})
    return result
