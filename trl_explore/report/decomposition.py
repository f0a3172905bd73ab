"""Why strategies differ: acting, the bias of the gradient, and the data.

For every strategy that was run together with softmax, three questions:

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
from math import inf

import numpy as np
from numpy.typing import NDArray

from trl_explore.names import option_of, strategy_label, symbol
from trl_explore.report.curves import Heights
from trl_explore.report.factors import canonical
from trl_explore.report.groups import Group
from trl_explore.statistics.comparisons import holm
from trl_explore.statistics.decomposition import Cells, aligned, share_of
from trl_explore.statistics.estimates import LEVEL, Estimate
from trl_explore.statistics.means import mean_difference, mean_interval
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import AGENT_GROUPS, NO_AGENT, trial_keys
from trl_explore.statistics.samples import Sample, iterations, score_range, scores

PLAIN, RATIO, AS_IF = "NoCorrection", "PerStep", "AsIf"
REFERENCE = "softmax"


@dataclass(frozen=True, eq=False)
class Run:
    """A configuration by both measures, and the heights of its curves, if they are known."""

    environment: str
    passed: Outcomes
    learned: Outcomes | None = None
    heights: Heights | None = None

    @property
    def option(self) -> str:
        """The class of its correction; empty if weights are clipped or normalised."""
        correction = self.passed.config.get("correction", {})
        unusual = correction.get("clip") is not None or correction.get("self_normalize")
        return "" if unusual else option_of(self.passed.config, "correction")

    @property
    def is_reference(self) -> bool:
        """Whether the actions are drawn from the policy itself."""
        return (
            self.passed.strategy == REFERENCE and self.passed.parameters.get("temperature", 1) == 1
        )

    @property
    def acts(self) -> str:
        """Canonical text of the strategy that acts."""
        return canonical([self.passed.strategy, self.passed.config.get("strategy")])

    @property
    def strategy(self) -> str:
        """Canonical text of the strategy alone, as a correction may name it."""
        return canonical(self.passed.config.get("strategy"))

    @property
    def assumes(self) -> str:
        """Canonical text of the strategy that its correction names."""
        return canonical(self.passed.config.get("correction", {}).get("strategy"))

    def samples(self) -> dict[str, Sample]:
        """Quantity -> its sample; without the quantities that are unknown."""
        found = {"passing": iterations(self.passed)}
        if self.learned is not None:
            found |= {"learning": iterations(self.learned), "learned_score": scores(self.learned)}
        if (h := self.heights) is not None:
            heights = {
                "height": h.learned, "behaved": h.behaved, "evaluated": h.evaluated,
                "handicap": h.evaluated - h.behaved,
            }  # fmt: skip
            passed = np.ones(len(h.keys), dtype=np.bool_)
            keys, scored = tuple(h.keys), score_range(self.passed.config.get("env"))
            found |= {
                k: Sample(k, "", x, passed, keys, bounds=(-inf, inf) if k == "handicap" else scored)
                for k, x in heights.items()
            }
        return found


@dataclass(frozen=True, eq=False)
class Crossing:
    """A strategy and softmax, each with a right and with a biased gradient.

    ``cells`` has ``reference`` and ``plain``, and of ``assumed`` and ``corrected`` those that were
    run; the names are those of ``statistics.decomposition``.
    """

    environment: str
    label: str
    cells: Mapping[str, Run]


def runs_of(group: Group, heights: Mapping[str, Heights]) -> list[Run]:
    """The configurations of a group."""
    learned = {c.name: c for c in group.learned}
    return [
        Run(group.environment, c, learned.get(c.name), heights.get(c.name))
        for c in group.configurations
    ]


def crossings(runs: Sequence[Run]) -> list[Crossing]:
    """Every strategy that was run together with softmax and has a further cell, in their order.

    The cells may belong to several experiments, but agree in everything else: environment, policy,
    loss, optimiser and stopping rule.
    """
    found = []
    places = _places(runs)
    for plain in runs:
        mates = [run for run in runs if _world(run) == _world(plain)]
        if plain.option != PLAIN or plain.is_reference or _first(mates, PLAIN, plain) is not plain:
            continue
        softmax = [run for run in mates if run.is_reference]
        right = [run for option in (PLAIN, RATIO) for run in softmax if run.option == option]
        cells = {"reference": right[0] if right else None, "plain": plain} | {
            "assumed": next((r for r in softmax if r.option == AS_IF
                             and r.assumes == plain.strategy), None),
            "corrected": _first(mates, RATIO, plain),
        }  # fmt: skip
        known = {name: run for name, run in cells.items() if run is not None}
        if right and len(known) > 2:
            found.append(Crossing(places[_world(plain)], _label(plain, mates), known))
    return found


def _first(runs: Sequence[Run], option: str, acting: Run) -> Run | None:
    return next((r for r in runs if r.option == option and r.acts == acting.acts), None)


def _label(run: Run, runs: Sequence[Run]) -> str:
    """The strategy; with its parameters if there are several of the name."""
    name, own = run.passed.strategy, run.passed.parameters
    alike = {r.acts for r in runs if r.passed.strategy == name}
    if len(alike) < 2:
        return strategy_label(name)
    shown = (f"{symbol(k)} = {v:g}" for k, v in own.items() if isinstance(v, int | float))
    return ", ".join([strategy_label(name), *shown])


def _places(runs: Sequence[Run]) -> dict[str, str]:
    """The name of every environment and its other settings, unique: "CartPole-v1, 2"."""
    found: dict[str, str] = {}
    for run in runs:
        if _world(run) not in found:
            name = run.environment
            count = sum(o == name or o.startswith(f"{name}, ") for o in found.values())
            found[_world(run)] = f"{name}, {count + 1}" if count else name
    return found


def _world(run: Run) -> str:
    """Canonical text of everything but the strategy and the correction."""
    config, o = run.passed.config, run.passed
    groups = {key: config.get(key) for key in AGENT_GROUPS if key != "correction"}
    if isinstance(env := groups.get("env"), Mapping):
        groups["env"] = {key: value for key, value in env.items() if key not in NO_AGENT}
    return canonical([groups, o.cap, o.threshold, o.window, config.get("stop_on", "training")])


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


@dataclass(frozen=True)
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


def decompose(runs: Sequence[Run], level: float = LEVEL) -> list[Decomposition]:
    """The decompositions of all strategies that the runs of a report allow, in their order."""
    found = []
    for c in crossings(runs):
        parts = {q: p for q in QUANTITIES if (p := _parts(q, c, level)) is not None}
        if parts:
            found.append(
                Decomposition(
                    environment=c.environment,
                    strategy=c.label,
                    name=c.cells["plain"].passed.strategy,
                    acting={k: a for k, run in c.cells.items() if (a := _acting(run, level))},
                    acting_share=_acting_share(c, level),
                    parts=parts,
                    passes=_passes(c),
                )
            )
    return _with_holm(found)


def _parts(quantity: str, crossing: Crossing, level: float) -> Parts | None:
    """The parts of one quantity; None if a cell that is needed lacks it, or no trial is common."""
    samples = {
        name: sample
        for name, run in crossing.cells.items()
        if (sample := run.samples().get(quantity)) is not None
    }
    if not {"reference", "plain"} < samples.keys():
        return None
    arrays = aligned([s.keys for s in samples.values()], [s.values for s in samples.values()])
    cells = Cells(**dict(zip(samples, arrays, strict=True)))
    if len(cells.gap) < 2:
        return None
    gap = mean_difference(samples["plain"], samples["reference"], level=level).estimate
    least = LEAST * max(abs(cells.plain.mean()), abs(cells.reference.mean()))
    divisible = gap.outside(0.0, 0.0) and abs(gap.value) >= least

    def share(part: NDArray[np.float64]) -> Estimate:
        return share_of(part, cells.gap, level=level) if divisible else NOT_ESTIMABLE

    assumed, corrected = cells.assumed, cells.corrected
    data = None
    if "corrected" in samples:
        data = mean_difference(samples["corrected"], samples["reference"], level=level)
    return Parts(
        quantity=quantity,
        n=len(cells.gap),
        reference=float(cells.reference.mean()),
        plain=float(cells.plain.mean()),
        gap=gap,
        assumed=None if assumed is None else share(assumed - cells.reference),
        corrected=None if corrected is None else share(cells.plain - corrected),
        bias=share(cells.bias),
        data=data.estimate if data else None,
        p_data=data.p_value if data else None,
    )


def _acting(run: Run, level: float) -> Acting | None:
    samples = run.samples()
    if "handicap" not in samples:
        return None
    quantities = ("behaved", "evaluated", "handicap")
    return Acting(*(mean_interval(samples[k], level=level) for k in quantities))


def _acting_share(crossing: Crossing, level: float) -> Estimate | None:
    pair = [crossing.cells[name].samples() for name in ("plain", "reference")]
    if any("handicap" not in samples for samples in pair):
        return None
    keys = [samples["behaved"].keys for samples in pair]
    behaved, handicap = (
        aligned(keys, [samples[k].values for samples in pair]) for k in ("behaved", "handicap")
    )
    if len(behaved[0]) < 2:
        return None
    return share_of(handicap[1] - handicap[0], behaved[0] - behaved[1], level=level)


def _passes(crossing: Crossing) -> tuple[int, int, int] | None:
    if "corrected" not in crossing.cells:
        return None
    both = [crossing.cells[name].passed for name in ("plain", "corrected")]
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
