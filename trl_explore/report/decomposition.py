"""Why strategies differ: acting, the bias of the gradient, and the data.

For every strategy that was run together with softmax, three questions:

* *acting*: how much of its score in training is lost to its own exploration? The same weights are
  played with and without it.
* *bias*: how much of its slower or smaller learning is due to the bias of its gradient? Either the
  gradient is corrected on its own data (per-step ratio), or softmax gets the same bias on the data
  of softmax (``correction=as_if``).
* *data*: what is left between corrected strategies, judged by what was learned?
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trl_explore.report.crossings import Cell, crossings
from trl_explore.statistics.comparisons import holm
from trl_explore.statistics.decomposition import Cells, aligned, share_of
from trl_explore.statistics.estimates import LEVEL, Estimate
from trl_explore.statistics.means import mean_difference, mean_interval
from trl_explore.statistics.pairing import trial_keys
from trl_explore.statistics.samples import Sample

QUANTITIES: Mapping[str, str] = {
    "learning": "iterations to learning",
    "height": "mean learned score over training",
    "learned_score": "final learned score",
    "passing": "iterations to passing",
    "behaved": "mean score in training",
}
"""Quantity of a trial -> its name. The first three describe what was learned."""

NEAR = 0.1
"""Two shares that differ by less are alike, even if their intervals do not overlap."""
LEAST = 0.05
"""The smallest difference that is divided into parts, as a share of the larger mean."""
NOT_ESTIMABLE = Estimate(np.nan, np.nan, np.nan)


@dataclass(frozen=True)
class Acting:
    """Mean scores of the same weights with and without exploration, and learned − behaved."""

    behaved: Estimate
    learned: Estimate
    handicap: Estimate


@dataclass
class Parts:
    """The difference between a strategy and softmax in one quantity, and its parts.

    A share is NaN, "not estimable", if the interval of the whole difference contains 0, or if the
    difference is small compared with the means (``LEAST``), as where hardly any trial learns.

    Attributes:
        quantity: a key of ``QUANTITIES``.
        n: the number of trials that all cells have in common.
        reference, plain: means of softmax, and of the strategy uncorrected.
        gap: plain − reference.
        assumed: share of the bias in the gap on the data of softmax; None if not run.
        corrected: share of the bias in the gap on the data of the strategy; None if not run.
        bias: the mean of both, or the only one.
        data: corrected − reference; None if the strategy was not run corrected.
        p_data: p-value of ``data``, after Holm's correction over the strategies.
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
    def separable(self) -> bool:
        """Whether both ways to measure the bias agree, so that bias and data simply add up."""
        if self.assumed is None or self.corrected is None or np.isnan(self.bias.value):
            return True
        near = abs(self.assumed.value - self.corrected.value) <= NEAR
        return near or not self.assumed.outside(self.corrected.low, self.corrected.high)

    @property
    def told_apart(self) -> bool:
        """Whether interval and test show an effect of the data."""
        if self.data is None or self.p_data is None:
            return False
        return self.p_data <= 1.0 - self.data.level and self.data.outside(0.0, 0.0)


@dataclass(frozen=True)
class Decomposition:
    """The answers for one strategy in one environment.

    Attributes:
        environment: its name; unique if other settings differ.
        strategy, name: of the strategy, for readers and in files.
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


def decompose(runs: Sequence[Cell], level: float = LEVEL) -> list[Decomposition]:
    """The decompositions of all strategies that the runs of a report allow, in their order.

    The p-values of the data are corrected over the strategies of an environment.
    """
    found = []
    for c in crossings(runs):
        samples = {name: run.samples() for name, run in c.cells.items()}
        parts = {q: p for q in QUANTITIES if (p := _parts(q, samples, level)) is not None}
        if parts:
            found.append(
                Decomposition(
                    environment=c.environment,
                    strategy=c.label,
                    name=c.cells["plain"].passed.strategy,
                    acting={
                        cell: Acting(
                            *(mean_interval(own[k], level=level)
                              for k in ("behaved", "evaluated", "handicap"))
                        )
                        for cell, own in samples.items()
                        if "handicap" in own
                    },
                    acting_share=_acting_share(samples, level),
                    parts=parts,
                    passes=_passes(c.cells),
                )
            )  # fmt: skip
    for environment in dict.fromkeys(d.environment for d in found):
        for quantity in QUANTITIES:
            tested = [p for d in found if d.environment == environment
                      and (p := d.parts.get(quantity)) and p.p_data is not None]  # fmt: skip
            for part, p in zip(tested, holm([p.p_data for p in tested]), strict=True):
                part.p_data = p
    return found


def _parts(quantity: str, cells: Mapping[str, Mapping[str, Sample]], level: float) -> Parts | None:
    """The parts of one quantity; None if a cell that is needed lacks it, or no trial is common."""
    samples = {name: own[quantity] for name, own in cells.items() if quantity in own}
    if not {"reference", "plain"} < samples.keys():
        return None
    arrays = aligned([s.keys for s in samples.values()], [s.values for s in samples.values()])
    x = Cells(**dict(zip(samples, arrays, strict=True)))
    if len(x.gap) < 2:
        return None
    gap = mean_difference(samples["plain"], samples["reference"], level=level).estimate
    least = LEAST * max(abs(x.plain.mean()), abs(x.reference.mean()))
    divisible = gap.outside(0.0, 0.0) and abs(gap.value) >= least

    def share(part: NDArray[np.float64]) -> Estimate:
        return share_of(part, x.gap, level=level) if divisible else NOT_ESTIMABLE

    data = None
    if x.corrected is not None:
        data = mean_difference(samples["corrected"], samples["reference"], level=level)
    return Parts(
        quantity=quantity,
        n=len(x.gap),
        reference=float(x.reference.mean()),
        plain=float(x.plain.mean()),
        gap=gap,
        assumed=None if x.assumed is None else share(x.assumed - x.reference),
        corrected=None if x.corrected is None else share(x.plain - x.corrected),
        bias=share(x.bias),
        data=data.estimate if data else None,
        p_data=data.p_value if data else None,
    )


def _acting_share(cells: Mapping[str, Mapping[str, Sample]], level: float) -> Estimate | None:
    pair = [cells[name] for name in ("plain", "reference")]
    if any("handicap" not in samples for samples in pair):
        return None
    keys = [samples["behaved"].keys for samples in pair]
    behaved, handicap = (
        aligned(keys, [samples[k].values for samples in pair]) for k in ("behaved", "handicap")
    )
    if len(behaved[0]) < 2:
        return None
    return share_of(handicap[1] - handicap[0], behaved[0] - behaved[1], level=level)


def _passes(cells: Mapping[str, Cell]) -> tuple[int, int, int] | None:
    if "corrected" not in cells:
        return None
    both = [cells[name].passed for name in ("plain", "corrected")]
    values = [o.converged.astype(np.float64) for o in both]
    plain, corrected = aligned([trial_keys(o) for o in both], values)
    return int(plain.sum()), int(corrected.sum()), len(plain)
