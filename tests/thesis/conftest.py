"""The invented configurations of the statistics."""

from tests.statistics.conftest import make, rng

__all__ = ["make", "rng"]
