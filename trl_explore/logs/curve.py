"""A curve without restarts, duplicate steps and values that are not finite."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Curve:
    """The scores of one run, by its steps.

    Attributes:
        step: not decreasing [n].
        score: finite [n].
        notes: what was left out or changed, one phrase each.
        ended_nan: whether the values after the last one were not finite.
    """

    step: NDArray[np.float64]
    score: NDArray[np.float64]
    notes: tuple[str, ...] = ()
    ended_nan: bool = False

    def __len__(self) -> int:
        return len(self.step)

    @property
    def last(self) -> float:
        """The last step; 0 without points."""
        return float(self.step[-1]) if len(self) else 0.0

    def smoothed(self, window: int) -> Curve:
        """The mean of the last ``window`` scores, at every step from the first full window on."""
        if window == 1 or len(self) < window:
            return self if window == 1 else Curve(self.step[:0], self.score[:0])
        total = np.cumsum(np.concatenate([[0.0], self.score]))
        return Curve(self.step[window - 1 :], (total[window:] - total[:-window]) / window)

    def at(self, grid: NDArray[np.float64]) -> NDArray[np.float64]:
        """The values at steps [m], linear between points; at both ends the nearest point's."""
        if not len(self):
            return np.full(len(grid), np.nan)
        # Of points at one step, the last counts.
        last = np.append(np.diff(self.step) > 0, True)
        return np.interp(grid, self.step[last], self.score[last])


def clean(
    step: NDArray[np.float64], score: NDArray[np.float64], *, episodes: bool = False
) -> Curve:
    """The curve of the points of a file, in the order of the file.

    Where steps go back, the run was continued from an earlier state: later values replace those
    of the steps that it repeats. Of equal steps the last value counts, except of ``episodes``,
    because several can end at once. Points that are not finite are left out.

    >>> curve = clean(np.array([1.0, 2, 3, 2, 3]), np.array([5.0, 6, 7, 8, 9]))
    >>> curve.score.tolist(), curve.notes
    ([5.0, 8.0, 9.0], ('restarted 1 time, 2 points replaced',))
    """
    notes = []
    placed = np.isfinite(step)
    step, score = step[placed], score[placed]
    finite = np.isfinite(score)
    ended_nan = len(finite) > 0 and not bool(finite[-1])
    back = np.diff(step, prepend=-np.inf) < 0
    if restarts := int(back.sum()):
        begins = np.full(len(step) + 1, np.inf)
        begins[:-1][back] = step[back]
        keep = step < np.minimum.accumulate(begins[::-1])[::-1][1:]
        notes.append(
            f"restarted {_times(restarts)}, {_count(int((~keep).sum()), 'point')} replaced"
        )
        step, score, finite = step[keep], score[keep], finite[keep]
    if bad := int((~finite).sum()):
        notes.append(f"{_count(bad, 'value')} not finite, left out")
        step, score = step[finite], score[finite]
    if not episodes:
        last = np.append(np.diff(step) > 0, True) if len(step) else np.zeros(0, bool)
        if twice := int((~last).sum()):
            notes.append(f"{_count(twice, 'duplicate step')}, the last value counts")
        step, score = step[last], score[last]
    return Curve(step, score, tuple(notes), ended_nan)


def _count(n: int, word: str) -> str:
    return f"{n:,} {word}{'s' * (n != 1)}"


def _times(n: int) -> str:
    return _count(n, "time")
