"""The measures of the runs of one environment, and their comparison.

All runs are judged over the same steps, up to the *horizon*. A score is smoothed over ``window``
points. A run has **passed** at the first step at which the smoothed score exceeds the threshold; a
run that has not passed by the horizon is right-censored there. The **final score** is the mean of
the smoothed score over the last tenth of the horizon, and the **area under the curve** its mean
over all steps, both with equal weight for every step, whatever the distance of the points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from statistics import median_low

import numpy as np
from numpy.typing import NDArray

from trl_explore.jobs.files import ResultsError
from trl_explore.logs.readers import Run
from trl_explore.statistics.comparisons import Measure
from trl_explore.statistics.estimates import Estimate, pass_rate
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.samples import Kind, Sample

GRID = 500
"""Points of the grid on which curves are averaged."""
WHOLE = 0.8
"""A run that ends before this share of the usual length of its configuration was cut off."""
WINDOW = 100
"""Most episodes of the window over which the scores of single episodes are smoothed."""


@dataclass(frozen=True, eq=False)
class Configuration:
    """The runs of one configuration [n].

    Attributes:
        keys: the seed of each run, or a key that no other run has.
        grid: steps from 0 to the horizon [m].
        curves: the smoothed scores on the grid [n, m].
        time: the step of passing, the horizon, or where a run was cut off [n].
        passed: whether each run passed [n].
        cut: whether each run ended before the horizon without having passed [n].
        diverged: whether its values stopped being finite before the horizon [n].
        final, area: final score and area under the curve [n]; NaN for runs that ended before the
            horizon.
    """

    name: str
    runs: Sequence[Run]
    keys: tuple[tuple[int, int], ...]
    grid: NDArray[np.float64]
    curves: NDArray[np.float64]
    time: NDArray[np.float64]
    passed: NDArray[np.bool_]
    cut: NDArray[np.bool_]
    diverged: NDArray[np.bool_]
    final: NDArray[np.float64]
    area: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.runs)

    def sample(self, values: NDArray[np.float64], kinds: Sequence[Kind] = ()) -> Sample:
        """The runs that have a value."""
        known = np.isfinite(values)
        whole = Sample(
            self.name, "", np.where(known, values, 0.0), self.passed, self.keys, tuple(kinds)
        )
        return whole.at(np.flatnonzero(known))

    def times(self) -> Sample:
        """The steps to passing, restricted to the horizon; not of runs that were cut off."""
        horizon = float(self.grid[-1])
        values = np.where(self.cut, np.nan, self.time)
        return self.sample(values, [Kind(~self.passed, horizon, horizon)])

    def outcomes(self) -> Outcomes:
        """The runs as outcomes, which is what the comparisons take."""
        horizon = int(self.grid[-1])
        seed, trial = np.array(self.keys, dtype=np.int64).reshape(-1, 2).T
        steps = np.maximum(np.ceil(self.time), 1).astype(np.int64)
        status = np.where(self.passed, "converged", np.where(self.cut, "stopped", "capped"))
        return Outcomes(
            name=self.name, experiment="", strategy=self.name, parameters={}, config={},
            cap=horizon, threshold=inf, window=1, trial=trial, seed=seed, iterations=steps,
            converged=self.passed, score=self.final, frames=steps,
            seconds=np.zeros(len(self)), status=status,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Task:
    """The runs of one environment, judged over the same steps.

    Attributes:
        environment: its name; empty if unknown.
        configurations: in the order of the runs.
        horizon: the last step.
        window: points over which scores are smoothed.
        threshold: the score that a run must exceed; None: no times.
        notes: sentences about what was left out or is approximate.
    """

    environment: str
    configurations: Sequence[Configuration]
    horizon: float
    window: int
    threshold: float | None
    notes: Sequence[str]

    def measures(self) -> list[Measure]:
        """The measures in which the configurations are compared."""
        of = {c.name: c for c in self.configurations}
        return [
            *([Measure("steps to the threshold", lambda o: of[o.name].times(), True)]
              if self.threshold is not None else []),
            Measure("final score", lambda o: of[o.name].sample(of[o.name].final)),
            Measure("area under the curve", lambda o: of[o.name].sample(of[o.name].area)),
        ]  # fmt: skip


def tasks(
    runs: Sequence[Run],
    *,
    threshold: float | Mapping[str, float] | None = None,
    window: int | None = None,
    horizon: float | None = None,
) -> list[Task]:
    """The runs of each environment, with all measures.

    Args:
        runs: from ``read_runs``; those that are not used are skipped.
        threshold: the score that a run must exceed, in all environments or in each.
        window: points to smooth over. By default 1, and for scores of single episodes 100, or a
            fifth of the episodes of the shortest run if that is less.
        horizon: the last step. By default the end of the shortest run that was not cut off.

    Raises:
        ResultsError: no runs, a threshold of an environment that has none, or a horizon that no
            run reaches.
    """
    used = [run for run in runs if run.used]
    if not used:
        raise ResultsError("no run has any values")
    environments = list(dict.fromkeys(run.environment for run in used))
    of = threshold if isinstance(threshold, Mapping) else dict.fromkeys(environments, threshold)
    for name in of:
        if name not in environments:
            known = ", ".join(environments)
            raise ResultsError(f"--threshold {name}=...: the environments are {known or 'unknown'}")
    return [
        _task(name, [r for r in used if r.environment == name], of.get(name), window, horizon)
        for name in environments
    ]


def _task(
    environment: str,
    runs: Sequence[Run],
    threshold: float | None,
    window: int | None,
    horizon: float | None,
) -> Task:
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(run.configuration, []).append(run)
    usual = {name: median_low([r.curve.last for r in g]) for name, g in groups.items()}
    whole = [r for r in runs if r.curve.last >= WHOLE * usual[r.configuration]]
    if window is None:
        fewest = min(len(run.curve) for run in whole)
        window = max(1, min(WINDOW, fewest // 5)) if runs[0].episodes else 1
    end = min(run.curve.last for run in whole) if horizon is None else horizon
    if end <= 0 or end > max(run.curve.last for run in runs):
        raise ResultsError(f"no run reaches step {end:,.0f}")
    grid = np.linspace(0.0, end, GRID + 1)
    # Unknown seeds get numbers that no other run has.
    free = iter(range(len(runs)))
    found = [
        _configuration(name, group, grid, threshold, window, [
            (r.seed, 0) if r.seed is not None else (-1, next(free)) for r in group
        ])
        for name, group in groups.items()
    ]  # fmt: skip
    return Task(environment, found, end, window, threshold, _notes(found, end, horizon))


def _configuration(
    name: str,
    runs: Sequence[Run],
    grid: NDArray[np.float64],
    threshold: float | None,
    window: int,
    keys: Sequence[tuple[int, int]],
) -> Configuration:
    end = float(grid[-1])
    smooth = [run.curve.smoothed(window) for run in runs]
    last = np.array([run.curve.last for run in runs])
    curves = np.array([curve.at(grid) for curve in smooth]).reshape(len(runs), len(grid))
    first = np.full(len(runs), np.inf)
    for i, curve in enumerate(smooth):
        above = np.flatnonzero(curve.score > (inf if threshold is None else threshold))
        first[i] = max(float(curve.step[above[0]]), 1.0) if len(above) else np.inf
    passed = first <= end
    # A log ends at its last report, up to one interval before the run does.
    gaps = np.array([np.diff(r.curve.step).max(initial=0.0) for r in runs])
    early = last + gaps < end
    diverged = early & np.array([run.curve.ended_nan for run in runs])
    time = np.where(passed, first, np.where(early & ~diverged, np.maximum(last, 1.0), end))
    values = np.where(early[:, None], np.nan, curves)
    return Configuration(
        name, runs, tuple(keys), grid, values, time, passed, early & ~diverged & ~passed, diverged,
        values[:, grid >= 0.9 * end].mean(1), values.mean(1),
    )  # fmt: skip


def _notes(found: Sequence[Configuration], end: float, horizon: float | None) -> list[str]:
    notes = []
    early = {c.name: int(np.isnan(c.final).sum()) for c in found if np.isnan(c.final).any()}
    if early:
        which = ", ".join(f"{name}: {n}" for name, n in early.items())
        notes.append(
            f"Runs that ended before step {end:,.0f} have no final score and no area ({which}). If"
            " bad runs end early, this makes their configuration look better than it is. A run that"
            " had not passed is censored where it ended; one that ended in values that are not"
            " finite counts as never passing."
        )
    longer = [c.name for c in found if min(r.curve.last for r in c.runs) > 1.05 * end]
    if longer and horizon is None:
        notes.append(
            f"The runs of {', '.join(longer)} are longer; they are judged by their first"
            f" {end:,.0f} steps, as all others."
        )
    unknown = [c.name for c in found if any(key[0] == -1 for key in c.keys)]
    if unknown:
        notes.append(f"The seeds of {', '.join(unknown)} are unknown: these runs are not paired.")
    return notes


def profile(values: NDArray[np.float64], scores: NDArray[np.float64]) -> list[Estimate]:
    """The performance profile: the share of runs [n] that score more than each of scores [m].

    Each with Wilson's interval, which is pointwise.

    Source: Agarwal et al., Deep RL at the Edge of the Statistical Precipice (2021), §4.2.

    >>> profile(np.array([1.0, 2.0, 3.0, 4.0]), np.array([2.0]))[0].value
    0.5
    """
    return [pass_rate(int((values > score).sum()), len(values)) for score in scores]


def seeds_text(runs: Sequence[Run]) -> str:
    """The seeds of runs, for a reader.

    >>> seeds_text([])
    'none'
    """
    seeds = sorted(run.seed for run in runs if run.seed is not None)
    unknown = len(runs) - len(seeds)
    ranges: list[list[int]] = []
    for seed in seeds:
        if ranges and seed == ranges[-1][-1] + 1:
            ranges[-1].append(seed)
        else:
            ranges.append([seed])
    parts = [f"{r[0]}–{r[-1]}" if len(r) > 2 else ", ".join(map(str, r)) for r in ranges]
    parts += [f"{unknown} unknown"] if unknown else []
    return ", ".join(parts) or "none"


def by_configuration(runs: Sequence[Run]) -> Mapping[tuple[str, str], list[Run]]:
    """The used runs of each environment and configuration."""
    groups: dict[tuple[str, str], list[Run]] = {}
    for run in runs:
        if run.used:
            groups.setdefault((run.environment, run.configuration), []).append(run)
    return groups
