"""The data of a study, with the queries that claims need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trl_explore.names import OPTIONS, option_of, strategy_label, symbol
from trl_explore.statistics.bootstrap import RESAMPLES
from trl_explore.statistics.estimates import LEVEL
from trl_explore.statistics.outcomes import Outcomes, convergence_times
from trl_explore.statistics.pairing import configuration_key, deduplicate, pool, trial_keys

STRATEGIES = ("random", "argmax", "epsilon_greedy", "decaying_epsilon_greedy", "softmax")

# The conditions under which the thesis made its statements (§2.3, §2.4.3, appendix A.4).
CAPS = {
    "thesis": 1000, "epsilon_grid": 1000, "decay_grid": 5000, "temperature_grid": 1000,
    "baselines": 1000, "corrections": 1000, "corrections_temperature": 1000,
}  # fmt: skip
THRESHOLD, WINDOW, ENV_ID = 195.0, 100, "CartPole-v1"
PARAMETERS: Mapping[str, Mapping[str, float]] = {
    "epsilon_greedy": {"epsilon": 0.3},
    "decaying_epsilon_greedy": {"decay": 0.99},
    "softmax": {"temperature": 1.0},
}


class NotMeasuredError(ValueError):
    """The data for a claim are missing, or were measured under other conditions."""


@dataclass(frozen=True, eq=False)
class Sample:
    """One measured quantity of the trials of one configuration.

    Attributes:
        label: name of the configuration in the evidence.
        unit: ``iterations``, ``frames`` or ``s``.
        values: [n].
        converged: [n].
        keys: (seed, trial) of each value; equal keys form pairs.

    """

    label: str
    unit: str
    values: NDArray[np.float64]
    converged: NDArray[np.bool_]
    keys: tuple[tuple[int, int], ...]

    def __len__(self) -> int:
        return len(self.values)

    def only(self, mask: NDArray[np.bool_], label: str | None = None) -> Sample:
        """Keep the trials where ``mask`` [n] is true."""
        keys = tuple(k for k, keep in zip(self.keys, mask, strict=True) if keep)
        name = label or self.label
        return Sample(name, self.unit, self.values[mask], self.converged[mask], keys)


@dataclass(frozen=True, eq=False)
class Study:
    """The outcomes of all experiments.

    A claim uses only jobs under the conditions of the thesis (cap, threshold, window, stopping by
    training scores, environment, parameters of the strategy). With other jobs it is ``not
    measured``, with the reason.

    Attributes:
        outcomes: one entry per job, of any experiments.
        seconds: wall time of trials run alone, ``experiment/name`` -> array [n].
        timed_trials: ``experiment/name`` -> trial index of each entry of ``seconds`` [n]; by
            default, the first n trials of the configuration, in order.
        level: confidence level of every verdict.
        resamples: number of resamples of every bootstrap and permutation test.
        strategies: the strategies meant by claims about all strategies.
        places: name of an experiment -> name of the experiment that replaces it.

    """

    outcomes: Sequence[Outcomes]
    seconds: Mapping[str, ArrayLike] = field(default_factory=dict)
    timed_trials: Mapping[str, ArrayLike] = field(default_factory=dict)
    level: float = LEVEL
    resamples: int = RESAMPLES
    strategies: Sequence[str] = STRATEGIES
    places: Mapping[str, str] = field(default_factory=dict)

    def under(self, correction: str) -> Study:
        """The study in which the experiments with corrections replace those without.

        ``corrections`` replaces ``thesis`` (without random, whose actions do not depend on what
        was learned); ``corrections_temperature`` replaces ``temperature_grid``. ``correction`` is
        the name of a class; ``NoCorrection`` is what the thesis did, on the same trials.
        """
        places = {"thesis": "corrections", "temperature_grid": "corrections_temperature"}
        chosen = [
            o
            for o in self.outcomes
            if o.experiment in places.values() and option_of(o.config, "correction") == correction
        ]
        strategies = [name for name in self.strategies if name != "random"]
        return replace(self, outcomes=chosen, strategies=strategies, places=places)

    def experiment(self, name: str) -> list[Outcomes]:
        """List the jobs of an experiment; trials that two jobs share count once.

        Raises:
            NotMeasuredError: there are no jobs, or a job contains a trial twice.

        """
        name = self.places.get(name, name)
        try:
            jobs = deduplicate([o for o in self.outcomes if o.experiment == name])
        except ValueError as error:
            raise NotMeasuredError(str(error)) from error
        if not jobs:
            raise NotMeasuredError(f"the experiment {name} was not run")
        return jobs

    def strategy(self, name: str, experiment: str = "thesis") -> Outcomes:
        """One strategy of an experiment with the thesis's parameters; seeds are pooled.

        Raises:
            NotMeasuredError: it was not run, or only with other parameters or conditions.

        """
        called = strategy_label(name)
        jobs = [o for o in self.experiment(experiment) if o.strategy == name]
        if not jobs:
            raise NotMeasuredError(f"{called} was not run in the experiment {experiment}")
        expected = PARAMETERS.get(name, {})
        alike = [o for o in jobs if all(o.parameters.get(k, v) == v for k, v in expected.items())]
        if not alike:
            wanted = ", ".join(f"{symbol(k)} = {v:g}" for k, v in expected.items())
            raise NotMeasuredError(f"{called} was not run with {wanted}, as in the thesis")
        if len({configuration_key(o) for o in alike}) > 1:
            raise NotMeasuredError(f"{experiment} has several configurations of {called}")
        return _pooled(alike)

    def choices(self, experiment: str, strategy: str, group: str) -> dict[str, Outcomes]:
        """Map a strategy's configurations by their option of ``correction`` or ``baseline``.

        Raises:
            NotMeasuredError: the experiment is missing, or an option has several configurations.

        """
        by_name: dict[str, list[Outcomes]] = {name: [] for name in OPTIONS[group]}
        for o in self.experiment(experiment):
            if o.strategy == strategy:
                by_name.setdefault(option_of(o.config, group), []).append(o)
        place = self.places.get(experiment, experiment)
        return {
            name: replace(self, outcomes=jobs, places={}).strategy(strategy, place)
            for name, jobs in by_name.items()
            if jobs
        }

    def grid(self, experiment: str, parameter: str) -> dict[float, Outcomes]:
        """Map a grid by the value of its parameter, ascending.

        Raises:
            NotMeasuredError: the experiment is missing, or a value has several configurations.

        """
        by_value: dict[float, list[Outcomes]] = {}
        for job in self.experiment(experiment):
            value = job.parameters.get(parameter)
            if isinstance(value, int | float):
                # A computed grid may contain 0.30000000000000004.
                by_value.setdefault(round(float(value), 9), []).append(job)
        for value, jobs in by_value.items():
            if len({configuration_key(o) for o in jobs}) > 1:
                raise NotMeasuredError(
                    f"{experiment} has several configurations with {symbol(parameter)} = {value:g}"
                )
        return {value: _pooled(by_value[value]) for value in sorted(by_value)}

    def sample(self, outcomes: Outcomes, unit: str, label: str | None = None) -> Sample:
        """Take the iterations (restricted to the cap), frames, or seconds of a configuration.

        Raises:
            NotMeasuredError: seconds were not measured or do not match the trials.

        """
        name = label or strategy_label(outcomes.strategy)
        keys, converged = trial_keys(outcomes), np.asarray(outcomes.converged, dtype=bool)
        if unit == "iterations":
            values = outcomes.durations.astype(np.float64)
        elif unit == "frames":
            values = outcomes.frames.astype(np.float64)
        else:
            values, where = self._seconds(outcomes)
            keys, converged = [keys[i] for i in where], converged[where]
        return Sample(name, unit, values, converged, tuple(keys))

    def _seconds(self, outcomes: Outcomes) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        key = f"{outcomes.experiment}/{outcomes.name}"
        if key not in self.seconds:
            raise NotMeasuredError(
                f"no trial of {strategy_label(outcomes.strategy)} was timed alone"
            )
        values = np.asarray(self.seconds[key], dtype=np.float64)
        trials = self.timed_trials.get(key)
        if trials is None:
            where = np.arange(len(values))
        else:
            first = {int(t): i for i, t in reversed(list(enumerate(outcomes.trial)))}
            where = np.array([first.get(int(t), -1) for t in np.asarray(trials)], dtype=np.intp)
        fits = len(where) == len(values) > 0 and (where >= 0).all() and len(values) <= len(outcomes)
        if not fits or not np.isfinite(values).all():
            raise NotMeasuredError(
                f"the timed trials of {strategy_label(outcomes.strategy)} do not match its trials"
            )
        return values, where


def _pooled(jobs: Sequence[Outcomes]) -> Outcomes:
    for job in jobs:
        _check_conditions(job)
    return pool(jobs)


def _check_conditions(job: Outcomes) -> None:
    wanted: list[tuple[str, Any, Any]] = [
        ("cap", job.cap, CAPS.get(job.experiment, job.cap)),
        ("threshold", job.threshold, THRESHOLD),
        ("window", job.window, WINDOW),
        ("stopping scores", job.judged_by, "training"),
    ]
    env = job.config.get("env")
    if isinstance(env, Mapping) and "id" in env:
        wanted.append(("environment", env["id"], ENV_ID))
    for word, found, expected in wanted:
        if found != expected:
            raise NotMeasuredError(
                f"{job.experiment}/{job.name} has {word} {found}, the thesis {expected}"
            )
    try:
        convergence_times(job)
    except ValueError as error:
        raise NotMeasuredError(str(error)) from error
