"""The configurations that differ from another only in how they act, or in what they correct."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trl_explore.names import option_of, strategy_label, symbol
from trl_explore.report.curves import Heights
from trl_explore.report.groups import Group
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import AGENT_GROUPS, NO_AGENT, trial_keys

PLAIN, RATIO, AS_IF = "NoCorrection", "PerStep", "AsIf"
REFERENCE = "softmax"
CELLS = ("reference", "plain", "assumed", "corrected")

Values = tuple[Sequence[tuple[int, int]], NDArray[np.float64]]
"""(seed, trial) of each trial [n], and its value [n]."""


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
        return _text([self.passed.strategy, self.passed.config.get("strategy")])

    @property
    def strategy(self) -> str:
        """Canonical text of the strategy alone, as a correction may name it."""
        return _text(self.passed.config.get("strategy"))

    @property
    def assumes(self) -> str:
        """Canonical text of the strategy that its correction names."""
        return _text(self.passed.config.get("correction", {}).get("strategy"))

    def values(self) -> dict[str, Values]:
        """Quantity -> the trials and their values; without those that are unknown."""
        keys = trial_keys(self.passed)
        found: dict[str, Values] = {"passing": (keys, self.passed.durations.astype(np.float64))}
        if (o := self.learned) is not None:
            found["learning"] = keys, o.durations.astype(np.float64)
            found["learned_score"] = keys, o.score.astype(np.float64)
        if (h := self.heights) is not None:
            found["height"] = h.keys, h.learned
            found["behaved"] = h.keys, h.behaved
            found["handicap"] = h.keys, h.evaluated - h.behaved
        return found


@dataclass(frozen=True, eq=False)
class Crossing:
    """A strategy beside softmax, each with a right and with a biased gradient.

    ``cells`` has the runs by their names in ``statistics.decomposition``; the last two may be
    missing.
    """

    label: str
    reference: Run
    plain: Run
    assumed: Run | None
    corrected: Run | None

    @property
    def cells(self) -> dict[str, Run]:
        """Name of the cell -> run."""
        named = {name: getattr(self, name) for name in CELLS}
        return {name: run for name, run in named.items() if run is not None}


def runs_of(group: Group, heights: Mapping[str, Heights]) -> list[Run]:
    """The configurations of a group."""
    learned = {c.name: c for c in group.learned}
    return [
        Run(group.environment, c, learned.get(c.name), heights.get(c.name))
        for c in group.configurations
    ]


def crossings(runs: Sequence[Run]) -> list[Crossing]:
    """Every strategy that was run beside softmax and has a further cell, in the order of the runs.

    The cells may belong to several experiments, but agree in everything else: environment, policy,
    loss, optimiser and stopping rule.
    """
    found = []
    for plain in runs:
        mates = [run for run in runs if _world(run) == _world(plain)]
        if plain.option != PLAIN or plain.is_reference or _first(mates, PLAIN, plain) is not plain:
            continue
        softmax = [run for run in mates if run.is_reference]
        right = [run for option in (PLAIN, RATIO) for run in softmax if run.option == option]
        biased = [r for r in softmax if r.option == AS_IF and r.assumes == plain.strategy]
        corrected = _first(mates, RATIO, plain)
        if right and (biased or corrected is not None):
            assumed = biased[0] if biased else None
            found.append(Crossing(_label(plain, runs), right[0], plain, assumed, corrected))
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


def _world(run: Run) -> str:
    """Canonical text of everything but the strategy and the correction."""
    config, o = run.passed.config, run.passed
    groups = {key: config.get(key) for key in AGENT_GROUPS if key != "correction"}
    if isinstance(env := groups.get("env"), Mapping):
        groups["env"] = {key: value for key, value in env.items() if key not in NO_AGENT}
    return _text([groups, o.cap, o.threshold, o.window, config.get("stop_on", "training")])


def _text(value: Any) -> str:
    """Canonical text, in which 1 and 1.0 are equal."""
    return json.dumps(json.loads(json.dumps(value, default=str), parse_int=float), sort_keys=True)
