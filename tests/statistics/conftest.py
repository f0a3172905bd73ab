"""Synthetic configurations with chosen durations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from trl_explore.statistics.outcomes import Outcomes

Factory = Callable[..., Outcomes]


def build(
    durations: Any,
    *,
    strategy: str = "softmax",
    cap: int = 1000,
    name: str | None = None,
    experiment: str = "thesis",
    parameters: dict[str, Any] | None = None,
    converged: Any = None,
    diverged: Any = (),
    seed: int = 0,
    first_trial: int = 0,
    score: Any = None,
    frames: Any = None,
    config: dict[str, Any] | None = None,
    threshold: float = 195.0,
    window: int = 100,
) -> Outcomes:
    """Durations below the cap have converged unless ``converged`` says otherwise."""
    iterations = np.asarray(durations, dtype=np.int64)
    n = len(iterations)
    done = iterations < cap if converged is None else np.asarray(converged, dtype=bool)
    status = np.where(done, "converged", "capped")
    status[list(diverged)] = "diverged"
    done = done & (status != "diverged")
    if score is None:
        score = np.where(done, 196.0, 100.0)
    return Outcomes(
        name=name or strategy,
        experiment=experiment,
        strategy=strategy,
        parameters=parameters or {},
        config=config or {},
        cap=cap,
        threshold=threshold,
        window=window,
        trial=np.arange(first_trial, first_trial + n),
        seed=np.full(n, seed),
        iterations=iterations,
        converged=done,
        score=np.asarray(score, dtype=np.float64),
        frames=iterations * 50 if frames is None else np.asarray(frames, dtype=np.int64),
        seconds=np.ones(n),
        status=status,
    )


@pytest.fixture
def make() -> Factory:
    return build


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20260101)
