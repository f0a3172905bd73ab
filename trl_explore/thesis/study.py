"""The data of a study, with the queries that claims need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trl_explore.names import OPTIONS, option_label, option_of, strategy_label, symbol
from trl_explore.statistics import samples
from trl_explore.statistics.estimates import LEVEL
from trl_explore.statistics.outcomes import Outcomes, convergence_times, judged
from trl_explore.statistics.pairing import configuration_key, deduplicate, pool, trial_keys
from trl_explore.statistics.samples import Sample

STRATEGIES = ("random", "argmax", "epsilon_greedy", "decaying_epsilon_greedy", "softmax")

# The conditions under which the thesis made its statements (§2.3, §2.4.3, appendix A.4).
CAPS = {
    "thesis": 1000, "thesis_learning": 1000, "epsilon_grid": 1000, "decay_grid": 5000,
    "temperature_grid": 1000,
    "baselines": 1000, "corrections": 1000, "corrections_temperature": 1000, "long_runs": 5000,
}  # fmt: skip
THRESHOLD, WINDOW, ENV_ID = 195.0, 100, "CartPole-v1"
PARAMETERS: Mapping[str, Mapping[str, float]] = {
    "epsilon_greedy": {"epsilon": 0.3},
    "decaying_epsilon_greedy": {"decay": 0.99},
    "softmax": {"temperature": 1.0},
}


class NotMeasuredError(ValueError):
    """The data for a claim are missing, or were measured under other conditions."""


Unit = str | float
"""``iterations``, ``score``, ``s``, or a number: frames, with this many more for each iteration."""


@dataclass(frozen=True, eq=False)
class Study:
    """The outcomes of all experiments.

    A claim uses only jobs under the conditions of the thesis (cap, threshold, window, stopping by
    training scores, environment, parameters of the strategy). With other jobs it is ``not
    measured``, with the reason.

    Attributes:
        outcomes: one entry per job, of any experiments.
        seconds: wall time of trials run alone, ``experiment/name`` -> array [n].
        timed_trials: the trial index of each of them [n]; by default, the first n trials.
        level: confidence level of every verdict.
        strategies: the strategies meant by claims about all strategies.
        places: name of an experiment -> name of the experiment that replaces it.
        measure: ``passed``, what a trial did while it explored, or ``learned``, what its policy
            does without the strategy (see :meth:`judged`).
        correction: the class of the correction, if :meth:`under` chose one.
    """

    outcomes: Sequence[Outcomes]
    seconds: Mapping[str, ArrayLike] = field(default_factory=dict)
    timed_trials: Mapping[str, ArrayLike] = field(default_factory=dict)
    level: float = LEVEL
    strategies: Sequence[str] = STRATEGIES
    places: Mapping[str, str] = field(default_factory=dict)
    measure: str = "passed"
    correction: str = ""

    def judged(self, measure: str) -> Study:
        """The same study by one measure: every claim is then decided by the same function.

        With ``learned``, ``converged``, iterations, frames and score are those of the policy
        without the strategy; jobs for which they are not known are left out. With ``passed``, a
        job that went on after passing counts as if it had stopped then.
        """
        found, passed = [], measure == "passed"
        for o in self.outcomes:
            try:
                found.append(judged(o, measure))
            except ValueError:
                # The conditions of the thesis then say why such a job is not used.
                found += [o] if passed else []
        if passed:
            return replace(self, outcomes=found, measure=measure)
        # If the five strategies were also run without a stop, nothing that they learn is cut off.
        whole = any(o.experiment == "thesis_learning" for o in found)
        places = {"thesis": "thesis_learning"} if whole else {}
        return replace(
            self,
            outcomes=found,
            seconds={},
            timed_trials={},
            places=places | dict(self.places),
            measure=measure,
        )

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
        return replace(
            self, outcomes=chosen, strategies=strategies, places=places, correction=correction
        )

    def experiment(self, name: str) -> list[Outcomes]:
        """The jobs of an experiment; trials that two jobs share count once.

        Raises:
            NotMeasuredError: there are no jobs, or a job contains a trial twice.
        """
        name = self.places.get(name, name)
        if name not in self._found:
            try:
                jobs = deduplicate([o for o in self.outcomes if o.experiment == name])
            except ValueError as error:
                raise NotMeasuredError(str(error)) from error
            self._found[name] = jobs
        if not self._found[name]:
            raise NotMeasuredError(f"the experiment {name} was not run")
        return self._found[name]

    @cached_property
    def _found(self) -> dict[str, list[Outcomes]]:
        return {}

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

    def corrected(self, strategy: str, corrections: Sequence[str] | str) -> dict[str, Outcomes]:
        """Class of a correction -> the strategy with it; the per-step ratio is among ``all``."""
        found = self.choices("corrections", strategy, "correction")
        every = corrections == "all"
        for name in ["PerStep"] if every else corrections:
            if name not in found:
                how = option_label("correction", name)
                raise NotMeasuredError(f"{strategy_label(strategy)} was not run with {how}")
        return found if every else {name: found[name] for name in corrections}

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

    def sample(self, outcomes: Outcomes, unit: Unit, label: str | None = None) -> Sample:
        """Take the iterations (restricted to the cap), score, time or seconds of a configuration.

        Raises:
            NotMeasuredError: seconds were not measured or do not match the trials; or a trial has
                no score.
        """
        name = label or strategy_label(outcomes.strategy)
        if unit == "iterations":
            return samples.iterations(outcomes, name)
        if unit == "score":
            found = samples.scores(outcomes, name)
            if len(found) < len(outcomes):
                raise NotMeasuredError(f"a trial of {name} has no score")
            return found
        if not isinstance(unit, str):
            return samples.frames(outcomes, name, per_iteration=unit)
        values, where = self._seconds(outcomes)
        keys, converged = trial_keys(outcomes), np.asarray(outcomes.converged, dtype=bool)[where]
        failed = samples.Kind(~converged, 0.0)
        return Sample(name, unit, values, converged, tuple(keys[i] for i in where), (failed,))

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
            first = outcomes.first_index
            where = np.array([first.get(int(t), -1) for t in np.asarray(trials)], dtype=np.intp)
        fits = len(where) == len(values) > 0 and (where >= 0).all() and len(values) <= len(outcomes)
        if not fits or not np.isfinite(values).all():
            raise NotMeasuredError(
                f"the timed trials of {strategy_label(outcomes.strategy)} do not match its trials"
            )
        return values, where


def _pooled(jobs: Sequence[Outcomes]) -> Outcomes:
    """One configuration, under the conditions of the thesis."""
    for job in jobs:
        _check_conditions(job)
    return pool(jobs)


def _check_conditions(job: Outcomes) -> None:
    wanted: list[tuple[str, Any, Any]] = [
        ("cap", job.cap, CAPS.get(job.experiment, job.cap)),
        ("threshold", job.threshold, THRESHOLD),
        ("window", job.window, WINDOW),
    ]
    if job.measure != "learned":
        wanted.append(("stopping scores", job.judged_by, "training"))
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
