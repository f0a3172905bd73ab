"""The synthetic configurations of the statistics' tests."""

from __future__ import annotations

from tests.statistics.conftest import make, rng

__all__ = ["make", "rng"]
