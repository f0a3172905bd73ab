"""The synthetic configurations of the statistics' tests, and a study of the thesis made of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.statistics.conftest import make, rng
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.thesis import CLAIMS, Finding, Study, check_claims
from trl_explore.thesis.study import PARAMETERS

__all__ = ["make", "rng"]

BY_ID = {claim.id: claim for claim in CLAIMS}
N = 1000


def times(low: int, high: int, failing: float = 0.0, *, n: int = N, cap: int = 1000) -> np.ndarray:
    """Evenly spread iterations in a fixed disorder; a share of the trials fails."""
    t = np.linspace(low, high, n).astype(int)
    t[: round(failing * n)] = cap
    return np.random.default_rng(low + high).permutation(t)


def shorten(values: dict[str, Any], n: int) -> dict[str, Any]:
    return {k: v[:n] if isinstance(v, np.ndarray) else v for k, v in values.items()}


CARTPOLE = {"env": {"id": "CartPole-v1", "max_steps": 500}}


def option(group: str, name: str) -> dict[str, Any]:
    return CARTPOLE | {group: {"_target_": f"trl_explore.objectives.{group}s.{name}"}}


class Builder:
    """A study in which nearly everything that the thesis says is true."""

    def __init__(self, make: Callable[..., Outcomes]) -> None:
        self.make = make
        spread = np.random.default_rng(0)
        self.thesis: dict[str, dict[str, Any]] = {
            "random": {
                "durations": np.full(N, 1000),
                "score": spread.uniform(20.5, 24.5, N),
                "frames": np.full(N, 8000) + np.arange(N),
            },
            "argmax": {
                "durations": times(460, 900, 0.55),
                "frames": np.where(times(460, 900, 0.55) < 1000, 60000, 10000) + np.arange(N),
            },
            "epsilon_greedy": {
                "durations": times(300, 700, 0.08),
                "frames": 50000 - (spread.exponential(6000, N)).astype(int).clip(max=30000),
            },
            "decaying_epsilon_greedy": {
                "durations": times(160, 260, 0.04),
                "frames": 38000 + (spread.exponential(6000, N)).astype(int),
            },
            "softmax": {"durations": times(110, 180), "frames": np.full(N, 30000) + np.arange(N)},
        }
        self.epsilons = {0.1: 0.6, 0.2: 0.5, 0.3: 0.04, 0.5: 0.9}
        slow = {0.9: 0.5, 0.97: 0.3, 0.98: 0.12, 0.99: 0.0, 0.995: 0.0}
        self.decays = {
            rate: {"durations": times(*((150, 250) if rate == 0.99 else (400, 800)), f, cap=5000)}
            for rate, f in slow.items()
        }
        self.temperatures = {0.5: times(110, 180), 1.0: times(300, 700), 2.0: times(500, 900)}
        self.baselines = {
            (strategy, name): times(low, low + 100)
            for strategy in ("softmax", "epsilon_greedy")
            for name, low in (("Constant", 500), ("EpisodeMean", 600), ("StepMean", 150))
        }
        self.long_runs = {
            "random": np.full(N, 5000),
            "argmax": times(460, 900, 0.55, cap=5000),
            "epsilon_greedy": times(300, 900, 0.08, cap=5000),
            "decaying_epsilon_greedy": times(160, 260, 0.05, cap=5000),
            "softmax": times(110, 180, cap=5000),
        }
        self.ratio = {
            "epsilon_greedy": times(200, 300),
            "decaying_epsilon_greedy": times(160, 260),
            "softmax": times(110, 180),
        }
        self.trials = N
        self.advantage = np.linspace(100.0, 300.0, N)

    def study(self, **options: Any) -> Study:
        outcomes = [
            self.make(
                strategy=s,
                parameters=dict(PARAMETERS.get(s, {})),
                config=CARTPOLE,
                **shorten(v, self.trials),
            )
            for s, v in self.thesis.items()
        ]
        for epsilon, failing in self.epsilons.items():
            outcomes.append(
                self.make(
                    times(200, 900, failing, n=self.trials),
                    strategy="epsilon_greedy",
                    parameters={"epsilon": epsilon},
                    experiment="epsilon_grid",
                    name=f"epsilon={epsilon}",
                )
            )
        for rate, values in self.decays.items():
            outcomes.append(
                self.make(
                    strategy="decaying_epsilon_greedy",
                    parameters={"decay": rate},
                    experiment="decay_grid",
                    name=f"decay={rate}",
                    cap=5000,
                    config=CARTPOLE,
                    **shorten(values, self.trials),
                )
            )
        for experiment, correction in (
            ("temperature_grid", "NoCorrection"),
            ("corrections_temperature", "Behaviour"),
        ):
            outcomes += [
                self.make(
                    durations[: self.trials],
                    parameters={"temperature": temperature},
                    experiment=experiment,
                    name=f"temperature={temperature}",
                    config=option("correction", correction),
                )
                for temperature, durations in self.temperatures.items()
            ]
        for strategy, durations in self.long_runs.items():
            outcomes.append(
                self.make(
                    durations[: self.trials],
                    strategy=strategy,
                    parameters=dict(PARAMETERS.get(strategy, {})),
                    experiment="long_runs",
                    cap=5000,
                )
            )
        for strategy, durations in self.ratio.items():
            outcomes.append(
                self.make(
                    durations[: self.trials],
                    strategy=strategy,
                    parameters=dict(PARAMETERS.get(strategy, {})),
                    experiment="corrections",
                    config=option("correction", "PerStep"),
                )
            )
        for (strategy, name), durations in self.baselines.items():
            outcomes.append(
                self.make(
                    durations[: self.trials],
                    strategy=strategy,
                    parameters=dict(PARAMETERS.get(strategy, {})),
                    experiment="baselines",
                    name=f"{strategy},{name}",
                    config=option("baseline", name),
                )
            )
        outcomes = [replace(o, learned_score=o.score + self.advantage[: len(o)]) for o in outcomes]
        seconds = {f"{o.experiment}/{o.name}": 1e-4 * o.frames for o in outcomes}
        return replace(Study(outcomes, seconds), **options)


@pytest.fixture
def builder(make) -> Builder:
    return Builder(make)


def finding(study: Study, claim_id: str) -> Finding:
    (checked,) = check_claims(study, [BY_ID[claim_id]])
    return checked.finding
