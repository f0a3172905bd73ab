"""Numbers with their intervals, as text with the digits that a reader can use."""

from __future__ import annotations

import math

from trl_explore.statistics.estimates import Estimate


def figure(x: float) -> str:
    """A number with at least three significant digits.

    >>> figure(1234.5), figure(44.68), figure(-0.01234), figure(math.inf)
    ('1,234', '44.7', '−0.0123', '∞')
    """
    if not math.isfinite(x):
        return "–" if math.isnan(x) else "∞" if x > 0 else "−∞"
    size = abs(x)
    digits = 0 if size >= 99.95 or size == 0 else 1 if size >= 9.995 else 2
    text = f"{x:,.{digits}f}" if size >= 0.9995 or size == 0 else f"{x:.3g}"
    return _signed(text)


def interval(e: Estimate) -> str:
    """An estimate with its interval.

    >>> interval(Estimate(27.31, 24.08, 30.6)), interval(Estimate(1.0, math.nan, math.nan))
    ('27.3 [24.1, 30.6]', '1.00')
    """
    if math.isnan(e.low):
        return figure(e.value)
    return f"{figure(e.value)} [{figure(e.low)}, {figure(e.high)}]"


def negated(e: Estimate) -> Estimate:
    """The estimate of −θ.

    >>> negated(Estimate(1.0, 0.5, 2.0))
    Estimate(value=-1.0, low=-2.0, high=-0.5, level=0.95)
    """
    return Estimate(-e.value, -e.high, -e.low, e.level)


def percent(e: Estimate | None) -> str:
    """A share with its interval in percent; a dash for None.

    >>> percent(Estimate(0.914, 0.9, 0.922)), percent(Estimate(math.nan, math.nan, math.nan))
    ('91 % [90, 92]', 'not estimable')
    """
    if e is None:
        return "–"
    if math.isnan(e.value):
        return "not estimable"
    value, low, high = (_signed(f"{100 * x:,.0f}") for x in (e.value, e.low, e.high))
    return f"{value} % [{low}, {high}]"


def p_value(p: float) -> str:
    """A p-value, or a bound.

    >>> p_value(0.04), p_value(0.00004)
    ('= 0.04', '< 0.001')
    """
    return "< 0.001" if p < 0.001 else f"= {p:.3f}".rstrip("0").rstrip(".")


def _signed(text: str) -> str:
    """The text with a proper minus, and none before zero."""
    nothing = not text.strip("-0.")
    return text.removeprefix("-") if nothing else text.replace("-", "−")
