"""Time to convergence as right-censored data: curve, median, restricted mean, running time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from trl_explore.statistics.bootstrap import RESAMPLES, bootstrap
from trl_explore.statistics.estimates import LEVEL, Estimate, check_level
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.proportions import pass_rate


@dataclass(frozen=True, eq=False)
class SurvivalCurve:
    """Ŝ(t), the share of trials that have not converged after t: a right-continuous step.

    All arrays have shape [k]: the time 0, every time at which a trial converged, and the
    horizon, in increasing order. Ŝ is constant from ``times[i]`` up to ``times[i + 1]``.

    Attributes:
        times: in the unit of the durations.
        survival: Ŝ(times), in [0, 1].
        low: lower end of the pointwise interval.
        high: upper end of the pointwise interval.
        at_risk: trials that are neither converged nor censored just before each time.
        events: trials that converged at each time.
        n: number of trials.
        level: confidence level of the interval.

    """

    times: NDArray[np.float64]
    survival: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    at_risk: NDArray[np.int64]
    events: NDArray[np.int64]
    n: int
    level: float = LEVEL

    def at(self, times: ArrayLike) -> NDArray[np.float64]:
        """Ŝ at any times [m] ≥ 0; beyond the horizon nothing is known: NaN."""
        t = np.asarray(times, dtype=np.float64)
        index = np.searchsorted(self.times, t, side="right") - 1
        return np.where(t > self.times[-1], np.nan, self.survival[index])


def convergence_times(
    outcomes: Outcomes, unit: str = "iterations"
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Durations and event indicators of a configuration, ready for :func:`kaplan_meier`.

    In iterations, a trial that did not converge is censored at the cap. In frames the cap is
    met after different numbers of frames, early by trials that score badly, so that censoring
    there would be informative and Kaplan-Meier too optimistic. Failed trials therefore stay
    at risk until the largest number of frames of any trial: Ŝ is then one minus the cumulative
    incidence of convergence with giving up as a competing event (Aalen-Johansen).

    Args:
        outcomes: one configuration.
        unit: ``iterations`` or ``frames``.

    Returns:
        durations [n] in the unit, converged [n].

    Raises:
        ValueError: another unit; a configuration without trials; a trial that converged after
            the cap, or stopped before it without converging or diverging (unfinished job).

    Source: Putter, Fiocco & Geskus, Statistics in Medicine 26 (2007), §3.

    """
    if unit not in ("iterations", "frames"):
        raise ValueError(f"unit={unit!r}: iterations or frames are possible")
    if len(outcomes) == 0:
        raise ValueError(f"{outcomes.name}: a configuration without trials")
    converged = np.asarray(outcomes.converged, dtype=bool)
    durations = outcomes.durations.astype(np.float64)
    wrong = np.where(converged, durations > outcomes.cap, durations != outcomes.cap)
    if wrong.any():
        i = int(np.argmax(wrong))
        how = "converged" if converged[i] else "stopped unconverged"
        raise ValueError(
            f"{outcomes.name}: trial {outcomes.trial[i]} {how} after {durations[i]:.0f} iterations,"
            f" which a finished job with cap {outcomes.cap} cannot contain"
        )
    if unit == "frames":
        frames = outcomes.frames.astype(np.float64)
        durations = np.where(converged, frames, frames.max())
    return durations, converged


def kaplan_meier(
    durations: ArrayLike, converged: ArrayLike, *, level: float = LEVEL
) -> SurvivalCurve:
    """Kaplan-Meier estimator of P(T > t) with a pointwise log-log interval.

    Ŝ(t) = Π_{t_i ≤ t} (1 - d_i / n_i)
    interval = Ŝ^exp(±z σ),  σ² = Σ_{t_i ≤ t} d_i / (n_i (n_i - d_i)) / (log Ŝ)²

    with d_i trials converging at t_i and n_i at risk; at equal times convergence comes before
    censoring. Where Ŝ is 1 or 0 Greenwood's variance is zero and the log-log interval
    undefined; Wilson's interval with all n trials stands there, so that "none of 3 converged"
    is not shown as certainty.

    Args:
        durations: time to convergence or censoring [n], > 0, any unit.
        converged: whether the trial converged [n].
        level: confidence level.

    Raises:
        ValueError: no trial, unequal lengths, or a duration that is not positive and finite.

    Source: Kaplan & Meier, JASA 53 (1958); Kalbfleisch & Prentice, The Statistical Analysis of
    Failure Time Data (2002), §1.4.

    >>> kaplan_meier([1, 2, 3, 3], [True, True, True, False]).survival
    array([1.  , 0.75, 0.5 , 0.25])

    """
    check_level(level)
    t, e = _check(durations, converged)
    n = len(t)
    event_times, d = np.unique(t[e], return_counts=True)
    at_risk = number_at_risk(t, event_times)
    s = np.cumprod(1.0 - d / at_risk)
    with np.errstate(divide="ignore"):
        greenwood = np.cumsum(np.where(at_risk > d, d / (at_risk * (at_risk - d)), 0.0))
    times, events = np.concatenate([[0.0], event_times]), np.concatenate([[0], d])
    survival = np.concatenate([[1.0], s])
    greenwood = np.concatenate([[0.0], greenwood])
    if t.max() > times[-1]:
        times, events = np.append(times, t.max()), np.append(events, 0)
        survival, greenwood = np.append(survival, survival[-1]), np.append(greenwood, greenwood[-1])
    low, high = _log_log(survival, greenwood, n, level)
    return SurvivalCurve(times, survival, low, high, number_at_risk(t, times), events, n, level)


def number_at_risk(durations: ArrayLike, times: ArrayLike) -> NDArray[np.int64]:
    """n(t) = #{trials with duration ≥ t}: neither converged nor censored before t.

    Args:
        durations: [n].
        times: [m], same unit.

    Returns:
        counts [m].

    >>> number_at_risk([5, 7, 7], [0, 5, 6, 8])
    array([3, 3, 2, 0])

    """
    t = np.sort(np.asarray(durations, dtype=np.float64))
    before = np.searchsorted(t, np.asarray(times, dtype=np.float64), side="left")
    return np.asarray(len(t) - before, dtype=np.int64)


def median_time(curve: SurvivalCurve) -> Estimate:
    """Median of T: the first t with Ŝ(t) ≤ ½; its interval, the t whose own interval has ½.

    Args:
        curve: from :func:`kaplan_meier`.

    Returns:
        In the unit of the curve; ``inf`` where the curve, or a bound of it, never comes down
        to one half ("not reached"); a lower bound of 0 where even Ŝ = 1 is compatible with ½
        (three trials or fewer).

    Source: Brookmeyer & Crowley, Biometrics 38 (1982).

    >>> median_time(kaplan_meier([1, 2, 3], [True, True, True])).value
    2.0

    """
    value, low, high = (
        float(curve.times[np.argmax(reached)]) if reached.any() else np.inf
        for reached in (band <= 0.5 + 1e-12 for band in (curve.survival, curve.low, curve.high))
    )
    return Estimate(value, low, high, curve.level)


def restricted_mean(
    durations: ArrayLike, converged: ArrayLike, horizon: float
) -> tuple[float, float]:
    """Restricted mean survival time E[min(T, τ)] with its standard error.

    μ̂ = ∫₀^τ Ŝ(t) dt,   Var μ̂ = n/(n-1) Σ_i (∫_{t_i}^τ Ŝ)² d_i / (n_i (n_i - d_i))

    Where trials are censored at τ only, as a cap does it, these are exactly the mean and
    s/√n of min(T, τ).

    Args:
        durations: [n].
        converged: [n].
        horizon: τ, the cap, in the same unit.

    Returns:
        (μ̂, standard error), unit of the durations; the error of a single trial is NaN.

    Raises:
        ValueError: as :func:`kaplan_meier`; a τ that is not positive, or beyond the last
            duration while trials were censored there (Ŝ is unknown from there on).

    Source: Royston & Parmar, BMC Medical Research Methodology 13 (2013).

    >>> restricted_mean([100, 200, 1000], [True, True, False], 1000)[0]
    433.3333333333333

    """
    t, e = _check(durations, converged)
    if not horizon > 0:
        raise ValueError(f"horizon={horizon}: a positive time is needed")
    if horizon > t.max() and not e[t == t.max()].all():
        raise ValueError(f"horizon={horizon}: trials are followed only until {t.max():g}")
    t, e = np.minimum(t, horizon), e & (t <= horizon)
    if e.all() or t[~e].min() >= horizon:
        # No censoring before the horizon: the plain mean, without the rounding of the integral.
        error = t.std(ddof=1) / np.sqrt(len(t)) if len(t) > 1 else np.nan
        return float(t.mean()), float(error)
    curve = kaplan_meier(t, e)
    widths = np.diff(np.append(curve.times, horizon))
    beyond = np.cumsum((curve.survival * widths)[::-1])[::-1]
    d, n_i = curve.events, curve.at_risk
    inner = (d > 0) & (n_i > d)
    variance = np.sum(beyond[inner] ** 2 * d[inner] / (n_i[inner] * (n_i[inner] - d[inner])))
    return float(beyond[0]), float(np.sqrt(variance * len(t) / (len(t) - 1)))


def expected_running_time(
    durations: ArrayLike,
    converged: ArrayLike,
    rng: np.random.Generator,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
) -> Estimate:
    """ERT: iterations until the first success, expected when failed trials are restarted.

    ERT = Σ_i duration_i / #{converged}, over all trials, failed ones with their whole cap

    Args:
        durations: [n].
        converged: [n].
        rng: source of the bootstrap over trials.
        level: confidence level.
        resamples: number of bootstrap resamples.

    Returns:
        In the unit of the durations; ``inf`` where none converged, and as upper bound where
        too many resamples contain no converged trial. Where none converged resampling cannot
        see a finite time, and the lower bound is mean duration / Wilson's upper bound of the
        pass rate. One trial has NaN bounds.

    Raises:
        ValueError: as :func:`kaplan_meier`.

    Source: Hansen et al., COCO: performance assessment (2016), §4.

    >>> expected_running_time([100, 300], [True, False], np.random.default_rng(0)).value
    400.0

    """
    t, e = _check(durations, converged)
    if not e.any() and len(t) > 1:
        least = float(t.mean() / pass_rate(0, len(t), level=level).high)
        return Estimate(np.inf, least, np.inf, level)
    return bootstrap(_ert, [t, e], rng, paired=True, level=level, resamples=resamples)


def _ert(t: NDArray[np.float64], e: NDArray[np.bool_]) -> Any:
    successes = e.sum(axis=-1)
    with np.errstate(divide="ignore"):
        return t.sum(axis=-1) / successes


def _check(
    durations: ArrayLike, converged: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    t, e = np.asarray(durations, dtype=np.float64), np.asarray(converged, dtype=bool)
    if t.ndim != 1 or t.shape != e.shape or len(t) == 0:
        raise ValueError(f"durations {t.shape} and converged {e.shape}: both [n], with n ≥ 1")
    if not (np.isfinite(t).all() and (t > 0).all()):
        raise ValueError(f"durations from {t.min()} to {t.max()}: all must be positive and finite")
    return t, e


def _log_log(
    s: NDArray[np.float64], greenwood: NDArray[np.float64], n: int, level: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    z = float(stats.norm.ppf((1.0 + level) / 2.0))
    inner = (s > 1e-12) & (s < 1.0 - 1e-12)
    p = np.where(inner, s, 0.5)
    width = np.exp(z * np.sqrt(greenwood) / np.abs(np.log(p)))
    wilson = n / (n + z**2)
    low = np.where(inner, p**width, np.where(s > 0.5, wilson, 0.0))
    high = np.where(inner, p ** (1.0 / width), np.where(s > 0.5, 1.0, 1.0 - wilson))
    return low, high
