"""How often the rule ``learned`` is fooled: ``python benchmarks/rule.py [--trials N]``.

Simulates trials that never learn: every score of every evaluation comes from one distribution whose
mean is the threshold, or lies below it. Prints the share of trials that are declared to have
learned, as the table of ``docs/measures.md``, and the mean number of confirmation episodes of an
evaluation.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from trl_explore.statistics.evaluations import LEARNED, UNDECIDED, decide, schedule, stages

Draw = Callable[[np.random.Generator, tuple[int, ...]], NDArray[np.float64]]
THRESHOLD, LOWEST, HIGHEST = 195.0, 9.0, 500.0
"""CartPole's."""
BELOW = (0.0, 0.05, 0.1, 0.2)
"""How far the true mean lies below the threshold, as a share of it."""


def two_points(low: float, rate: float | None = None) -> Callable[[float], Draw]:
    """Score ``low`` at the given rate, else a higher one; no rate: the higher one is 500."""

    def of(mean: float) -> Draw:
        share = (HIGHEST - mean) / (HIGHEST - low) if rate is None else rate
        high = (mean - share * low) / (1 - share)
        return lambda rng, shape: np.where(rng.random(shape) < share, low, high)

    return of


SHAPES: dict[str, Callable[[float], Draw]] = {
    "normal, sd 100": lambda m: lambda rng, shape: rng.normal(m, 100, shape),
    "normal, sd 10": lambda m: lambda rng, shape: rng.normal(m, 10, shape),
    "9 or 500": two_points(LOWEST),
    "exponential": lambda m: lambda rng, shape: rng.exponential(m, shape),
    "uniform": lambda m: lambda rng, shape: rng.uniform(0, 2 * m, shape),
    "skewed to the left": lambda m: lambda rng, shape: m + 100 - rng.exponential(100, shape),
    "always the mean": lambda m: lambda rng, shape: np.full(shape, m),
    **{f"9 in 1 of {n}": two_points(LOWEST, 1 / n) for n in (2, 4, 7, 10, 15, 20, 30, 50, 100)},
}


def fooled(
    draw: Draw,
    threshold: float = THRESHOLD,
    *,
    trials: int,
    cap: int = 1000,
    episodes: int = 1,
    most: int = 500,
    seed: int = 0,
) -> tuple[float, float]:
    """The share of trials that are declared to have learned, and confirmation episodes per look.

    Args:
        draw: scores of a shape.
        threshold: the rule's.
        trials: the number of simulated trials.
        cap: the iterations of a trial, with the evaluations of ``auto``.
        episodes: ``evaluate_episodes``.
        most: ``evaluate_confirm``.
        seed: of the simulation.
    """
    rng = np.random.default_rng(seed)
    looks = schedule("auto", cap)
    assert looks is not None
    learned, played = np.zeros(trials, dtype=bool), 0
    lowest = draw(rng, (trials, episodes)).min(1)  # iteration 0
    for _ in looks[1:]:
        scores = draw(rng, (trials, episodes))
        lowest = np.minimum(lowest, scores.min(1))
        todo = np.flatnonzero(~learned & (scores.mean(1) > threshold))
        known = np.empty((len(todo), 0))
        for n in stages(most):
            fresh = draw(rng, (len(todo), n - known.shape[1]))
            played += fresh.size
            known = np.concatenate([known, fresh], axis=1)
            if not len(todo):
                break
            lowest[todo] = np.minimum(lowest[todo], fresh.min(1))
            verdict = decide(known, lowest[todo], threshold, most)
            learned[todo[verdict == LEARNED]] = True
            todo, known = todo[verdict == UNDECIDED], known[verdict == UNDECIDED]
    return float(learned.mean()), played / trials / (len(looks) - 1)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--trials", type=int, default=10000, help="trials of each cell")
    trials = parser.parse_args().trials
    print("| scores | most | " + " | ".join(f"{b:.0%} below" for b in BELOW) + " | episodes |")
    print("|---|---|" + "---|" * (len(BELOW) + 1))
    for most in (100, 500):
        for name, shape in SHAPES.items():
            cells = [fooled(shape(THRESHOLD * (1 - b)), trials=trials, most=most) for b in BELOW]
            shares = " | ".join(f"{share:.2%}" for share, _ in cells)
            print(f"| {name} | {most} | {shares} | {cells[0][1]:.0f} |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
