"""One number for each trial of a configuration, with what is needed to compare its mean."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trl_explore.statistics.outcomes import Outcomes, convergence_times
from trl_explore.statistics.pairing import common, trial_keys

Key = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Kind:
    """Trials of a rare kind, whose values differ from those of the ordinary trials.

    Attributes:
        members: whether each trial is of this kind, [n].
        least, most: bounds of the value of such a trial, known before one is seen; equal if the
            value is known, infinite if nothing is.
    """

    members: NDArray[np.bool_]
    least: float = -inf
    most: float = inf


@dataclass(frozen=True, eq=False)
class Sample:
    """One measured quantity of the trials of one configuration.

    Attributes:
        label: name of the configuration in texts.
        unit: ``iterations``, ``frames``, ``s`` or nothing.
        values: [n], all finite.
        converged: whether each trial converged, [n].
        keys: (seed, trial) of each value; equal keys form pairs.
        kinds: the rare kinds, the failed trials first; empty: all trials are of one kind.
        bounds: what no value can be below or above.
    """

    label: str
    unit: str
    values: NDArray[np.float64]
    converged: NDArray[np.bool_]
    keys: tuple[Key, ...]
    kinds: tuple[Kind, ...] = ()
    bounds: tuple[float, float] = (-inf, inf)

    def __post_init__(self) -> None:
        sizes = {len(self.values), len(self.converged), len(self.keys)}
        if len(sizes | {len(kind.members) for kind in self.kinds}) > 1:
            raise ValueError(f"{self.label}: arrays of {sorted(sizes)} trials: all need the same")
        if not np.isfinite(self.values).all():
            raise ValueError(f"{self.label}: a value is not finite")

    def __len__(self) -> int:
        return len(self.values)

    @classmethod
    def of(
        cls,
        values: ArrayLike,
        failed: ArrayLike | None = None,
        *,
        least: float = -inf,
        most: float = inf,
        label: str = "",
        unit: str = "",
    ) -> Sample:
        """A sample from arrays [n], paired by position; without ``failed``, no trial can fail.

        ``least`` and ``most`` bound the value of a failed trial.
        """
        x = np.asarray(values, dtype=np.float64)
        bad = np.zeros(len(x), bool) if failed is None else np.asarray(failed, dtype=bool)
        kinds = () if failed is None else (Kind(bad, least, most),)
        return cls(label, unit, x, ~bad, tuple((0, i) for i in range(len(x))), kinds)

    @cached_property
    def ordinary(self) -> NDArray[np.bool_]:
        """Whether each trial is of no rare kind, [n]."""
        rare = np.zeros(len(self), dtype=bool)
        for kind in self.kinds:
            rare |= kind.members
        return ~rare

    @cached_property
    def cap(self) -> float | None:
        """The value of every failed trial, if it is known and there are no other rare kinds."""
        known = len(self.kinds) == 1 and self.kinds[0].least == self.kinds[0].most
        return self.kinds[0].most if known else None

    def simplified(self) -> Sample:
        """The sample as one kind of trials if fewer than two ordinary ones would be left.

        Except for times, where the value of a failed trial is known without them.
        """
        few = np.count_nonzero(self.ordinary) < 2 and self.cap is None
        return replace(self, kinds=()) if few else self

    def at(self, index: NDArray[Any]) -> Sample:
        """The trials at positions ``index`` [m]."""
        return replace(
            self,
            values=self.values[index],
            converged=self.converged[index],
            keys=tuple(self.keys[i] for i in index),
            kinds=tuple(replace(kind, members=kind.members[index]) for kind in self.kinds),
        )

    def only(self, mask: NDArray[np.bool_], label: str | None = None) -> Sample:
        """Keep one kind of trials: those where ``mask`` [n], an outcome, is true."""
        kind = self.at(np.flatnonzero(mask))
        return replace(kind, label=label or self.label, kinds=())

    def scaled(self, factor: float, shift: float = 0.0) -> Sample:
        """``factor`` × (value - ``shift``), for a positive factor."""
        kinds = tuple(
            replace(k, least=factor * (k.least - shift), most=factor * (k.most - shift))
            for k in self.kinds
        )
        low, high = (factor * (bound - shift) for bound in self.bounds)
        values = factor * (self.values - shift)
        return replace(self, values=values, kinds=kinds, bounds=(low, high))


def iterations(o: Outcomes, label: str = "") -> Sample:
    """Iterations restricted to the cap, min(T, cap); a failed trial counts as the cap.

    Raises:
        ValueError: an unfinished job (see ``convergence_times``).
    """
    durations, converged = convergence_times(o)
    least = float(durations[~converged].min(initial=o.cap))
    failed = Kind(~converged, least, float(o.cap))
    return _sample(o, label, "iterations", durations, (failed,))


def frames(o: Outcomes, label: str = "", *, per_iteration: float = 0.0) -> Sample:
    """Frames until a trial stopped, plus the cost of its iterations, ``per_iteration`` frames each.

    A failed trial plays the cap's number of episodes, each of at most ``max_steps`` frames; in
    CartPole, where each frame scores 1, of at most the threshold on average.
    """
    per_update = o.config.get("episodes_per_update", 1)
    episodes = o.cap * (per_update if isinstance(per_update, int) else inf)
    fixed = o.cap * per_iteration
    steps = _environment(o).get("max_steps") or inf
    if _environment(o).get("id") == "CartPole-v1" and o.judged_by == "training":
        steps = min(steps, o.threshold)
    failed = Kind(~o.converged, float(fixed), fixed + episodes * steps)
    return _sample(o, label, "frames", o.frames + per_iteration * o.iterations, (failed,))


def scores(o: Outcomes, label: str = "") -> Sample:
    """Final scores of the trials that have one.

    Two rare kinds: failed trials, which score at most the threshold, and trials that pass with
    their first full window, which may score far above it, while all others stop just above it. The
    range of scores is known for the environments of ``SCORES``. Elsewhere, what an unseen trial of
    a rare kind would score is unknown, and intervals are infinite until two of a kind were seen.
    """
    score = np.asarray(o.score, dtype=np.float64)
    converged, known = np.asarray(o.converged, dtype=bool), np.isfinite(score)
    least, most = score_range(o.config.get("env"), score[known])
    highest = float(score[~converged & known].max(initial=o.threshold))
    kinds = [Kind(~converged, least, highest)]
    per_update = o.config.get("episodes_per_update", 1)
    if o.judged_by == "training" and isinstance(per_update, int):
        first = converged & (o.iterations * per_update < o.window + per_update)
        kinds.append(Kind(first, o.threshold, most))
    found = _sample(o, label, "", np.where(known, score, 0.0), kinds)
    return replace(found, bounds=(least, most)).at(np.flatnonzero(known))


def score_range(env: Any, found: ArrayLike = ()) -> tuple[float, float]:
    """The least and the highest score of an episode in a configured environment.

    Infinite for environments that are not in ``SCORES``, and if a score that was found lies
    outside: a wrapper or an argument of the environment has changed its rewards.
    """
    if not isinstance(env, Mapping):
        return -inf, inf
    bounds, steps = SCORES.get(re.sub(r"-v\d+$", "", str(env.get("id")))), env.get("max_steps")
    least, most = bounds(float(steps or inf)) if bounds else (-inf, inf)
    inside = all(least <= score <= most for score in np.ravel(found))
    return (least, most) if inside else (-inf, inf)


SCORES: Mapping[str, Callable[[float], tuple[float, float]]] = {
    "CartPole": lambda steps: (0.0, steps),
    "FrozenLake": lambda steps: (0.0, 1.0),
    "FrozenLake8x8": lambda steps: (0.0, 1.0),
    "Acrobot": lambda steps: (-steps, 0.0),
    "MountainCar": lambda steps: (-steps, 0.0),
    "CliffWalking": lambda steps: (-100.0 * steps, 0.0),
    "Taxi": lambda steps: (-10.0 * steps, 20.0),
    "trl_explore/Catch": lambda steps: (-1.0, 1.0),
    "trl_explore/SparseMountainCar": lambda steps: (0.0, 1.0),
}
"""Environment, in any version -> the range of scores of an episode with a number of steps."""


def common_trials(a: Sample, b: Sample) -> tuple[Sample, Sample, bool]:
    """The common trials of two samples, as pairs; both samples, unpaired, if there are none."""
    if a.keys == b.keys:
        return a, b, len(a) > 0
    i, j = common(a.keys, b.keys)
    return (a.at(i), b.at(j), True) if len(i) else (a, b, False)


def _environment(o: Outcomes) -> Mapping[str, Any]:
    env = o.config.get("env")
    return env if isinstance(env, Mapping) else {}


def _sample(
    o: Outcomes, label: str, unit: str, values: NDArray[Any], kinds: Sequence[Kind]
) -> Sample:
    return Sample(
        label=label or o.name,
        unit=unit,
        values=np.asarray(values, dtype=np.float64),
        converged=np.asarray(o.converged, dtype=bool),
        keys=tuple(trial_keys(o)),
        kinds=tuple(kinds),
    )
