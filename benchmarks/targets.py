"""The speed and memory targets, and whether they are met."""

from __future__ import annotations

from dataclasses import dataclass

from plan import BOTH_CORES, Case, Measured
from runs import STRATEGIES


@dataclass(frozen=True)
class Target:
    """One target.

    Attributes:
        name: what is measured.
        measured: the value.
        limit: the limit for the value.
        at_least: whether the limit is a lower limit; if not, it is an upper limit.
        unit: written after both numbers.
    """

    name: str
    measured: float
    limit: float
    at_least: bool
    unit: str

    @property
    def met(self) -> bool:
        """Whether the value is within the limit."""
        if self.at_least:
            return self.measured >= self.limit
        return self.measured <= self.limit

    @property
    def wanted(self) -> str:
        """The limit in words."""
        return f"{'at least' if self.at_least else 'at most'} {self.limit:g}{self.unit}"


def targets(m: Measured) -> list[Target]:
    """All targets, with the measured values."""
    plain, stock = m.speed(Case("plain")), m.speed(Case("stock"))
    thesis = sum(map(m.plain_seconds, STRATEGIES)) / m.thesis_seconds()
    many, most = m.speed(Case("fused", 1_500)), m.speed(Case("fused", 15_000))
    found = [
        Target("thesis, 5 strategies × 30 trials, against the plain loop", thesis, 25, True, "×"),
        Target("1,500 trials, against the plain loop", many / plain, 150, True, "×"),
        Target("time per frame, 15,000 against 1,500 trials", many / most, 1, False, "×"),
        Target("peak memory at 15,000 trials", m.memory[1], 2, False, " GB"),
    ]
    for trials in BOTH_CORES:
        one, two = Case("fused", trials), Case("fused", trials, 2)
        if two in m.runs:
            gain = m.speed(two) / m.speed(one)
            found.append(Target(f"two cores against one, {trials:,} trials", gain, 1.6, True, "×"))
    return [
        *found,
        Target("`train.py` beyond importing torchrl", m.start_beyond_torchrl(), 3, False, " s"),
        Target("`train.py --help`", m.start("train.py --help"), 1.5, False, " s"),
        *(
            Target(
                f"TorchRL lanes, {trials} trials, against stock",
                m.speed(Case("lanes", trials)) / stock, factor, True, "×",
            )
            for trials, factor in ((30, 5), (300, 25))
        ),
    ]  # fmt: skip
