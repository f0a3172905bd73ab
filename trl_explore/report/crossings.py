"""Which configurations are divided into parts: a strategy and softmax, each with both gradients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trl_explore.names import option_of, strategy_label, symbol
from trl_explore.report.curves import Heights
from trl_explore.report.factors import canonical
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import AGENT_GROUPS, NO_AGENT
from trl_explore.statistics.samples import Sample, iterations, score_range, scores

PLAIN, RATIO, AS_IF = "NoCorrection", "PerStep", "AsIf"
REFERENCE = "softmax"


@dataclass(frozen=True, eq=False)
class Cell:
    """A configuration by both measures, and the heights of its curves, if they are known."""

    environment: str
    passed: Outcomes
    learned: Outcomes | None = None
    heights: Heights | None = None

    def group(self, name: str) -> Mapping[str, Any]:
        """A group of its configuration."""
        return self.passed.config.get(name, {})

    @property
    def option(self) -> str:
        """The class of its correction; empty if weights are clipped or normalised."""
        unusual = self.group("correction").get("clip") is not None
        unusual = unusual or self.group("correction").get("self_normalize")
        return "" if unusual else option_of(self.passed.config, "correction")

    @property
    def acts(self) -> str:
        """Canonical text of the strategy that acts."""
        return canonical([self.passed.strategy, self.passed.config.get("strategy")])

    @property
    def world(self) -> str:
        """Canonical text of everything but the strategy and the correction."""
        o = self.passed
        groups = {key: o.config.get(key) for key in AGENT_GROUPS if key != "correction"}
        if isinstance(env := groups.get("env"), Mapping):
            groups["env"] = {key: value for key, value in env.items() if key not in NO_AGENT}
        return canonical([groups, o.cap, o.threshold, o.window,
                          o.config.get("stop_on", "training")])  # fmt: skip

    def samples(self) -> dict[str, Sample]:
        """Quantity -> its sample; without the quantities that are unknown."""
        found = {"passing": iterations(self.passed)}
        if self.learned is not None:
            found |= {"learning": iterations(self.learned), "learned_score": scores(self.learned)}
        if (h := self.heights) is not None:
            keys = tuple(h.keys)
            passed = np.ones(len(keys), dtype=np.bool_)
            heights = {"height": h.learned, "behaved": h.behaved, "evaluated": h.evaluated}
            bounds = score_range(self.group("env"), np.concatenate(list(heights.values())))
            found |= {k: Sample(k, "", x, passed, keys, bounds=bounds) for k, x in heights.items()}
            found["handicap"] = Sample("handicap", "", h.evaluated - h.behaved, passed, keys)
        return found


@dataclass(frozen=True, eq=False)
class Crossing:
    """A strategy and softmax, each with a right and with a biased gradient.

    ``cells`` has ``reference`` and ``plain``, and of ``assumed`` and ``corrected`` those that were
    run; the names are those of ``statistics.decomposition``.
    """

    environment: str
    label: str
    cells: Mapping[str, Cell]


def crossings(runs: Sequence[Cell]) -> list[Crossing]:
    """Every strategy that was run together with softmax and has a further cell, in their order.

    The cells may belong to several experiments, but agree in everything else: environment, policy,
    loss, optimiser and stopping rule.
    """
    found, places = [], _places(runs)
    for plain in runs:
        mates = [run for run in runs if run.world == plain.world]
        own = {run.option: run for run in reversed(mates) if run.acts == plain.acts}
        softmax = [run for run in mates if run.passed.strategy == REFERENCE
                   and run.passed.parameters.get("temperature", 1) == 1]  # fmt: skip
        if plain.option != PLAIN or plain in softmax or own[PLAIN] is not plain:
            continue
        right = [run for option in (PLAIN, RATIO) for run in softmax if run.option == option]
        strategy = canonical(plain.passed.config.get("strategy"))
        biased = [run for run in softmax if run.option == AS_IF
                  and canonical(run.group("correction").get("strategy")) == strategy]  # fmt: skip
        cells = {
            "reference": next(iter(right), None), "plain": plain,
            "assumed": next(iter(biased), None), "corrected": own.get(RATIO),
        }  # fmt: skip
        known = {name: run for name, run in cells.items() if run is not None}
        if right and len(known) > 2:
            found.append(Crossing(places[plain.world], _label(plain, mates), known))
    return found


def _label(run: Cell, runs: Sequence[Cell]) -> str:
    """The strategy; with its parameters if there are several of the name."""
    name, own = run.passed.strategy, run.passed.parameters
    several = len({r.acts for r in runs if r.passed.strategy == name}) > 1
    shown = [f"{symbol(k)} = {v:g}" for k, v in own.items() if isinstance(v, int | float)]
    return ", ".join([strategy_label(name), *(shown if several else ())])


def _places(runs: Sequence[Cell]) -> dict[str, str]:
    """The name of every environment and its other settings, unique: "CartPole-v1, 2"."""
    found: dict[str, str] = {}
    for run in runs:
        if run.world not in found:
            name = run.environment
            count = sum(o == name or o.startswith(f"{name}, ") for o in found.values())
            found[run.world] = f"{name}, {count + 1}" if count else name
    return found
