"""Share of trials with a property, with Wilson's interval."""

from __future__ import annotations

from typing import Any

from statsmodels.stats.proportion import proportion_confint

from trl_explore.statistics.estimates import LEVEL, Estimate, check_level


def pass_rate(successes: float, trials: int, *, level: float = LEVEL) -> Estimate:
    """Binomial proportion p̂ = k / n with Wilson's score interval.

    (p̂ + z²/2n ± z √(p̂(1-p̂)/n + z²/4n²)) / (1 + z²/n),  z = Φ⁻¹((1 + level) / 2)

    The set of p that the score test does not reject; unlike p̂ ± z·se it stays in [0, 1] and
    has a width also at k = 0 and k = n.

    Args:
        successes: k, the number of trials that passed (a tie may count half).
        trials: n.
        level: confidence level.

    Returns:
        Proportion in [0, 1] with its interval.

    Raises:
        ValueError: n < 1, or k outside 0..n.

    Source: Wilson, JASA 22 (1927); Brown, Cai & DasGupta, Statistical Science 16 (2001).

    >>> estimate = pass_rate(0, 30)
    >>> round(estimate.low, 3), round(estimate.high, 3)
    (0.0, 0.114)

    """
    check_level(level)
    if trials < 1:
        raise ValueError(f"trials={trials}: a proportion needs at least one trial")
    if not 0 <= successes <= trials:
        raise ValueError(f"successes={successes}: between 0 and trials={trials} are possible")
    bounds: Any = proportion_confint(successes, trials, alpha=1.0 - level, method="wilson")
    low, high = bounds
    # At k = 0 and k = n the closed form leaves 1e-17 where the bound is exactly 0 or 1.
    return Estimate(
        successes / trials,
        0.0 if successes == 0 else float(low),
        1.0 if successes == trials else float(high),
        level,
    )
