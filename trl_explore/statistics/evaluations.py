"""When a trial is evaluated, and when it has learned: the rule looks at it many times.

Evaluations play the policy without its exploration strategy, on fresh episodes. A trial that is
looked at forty times has a good chance of one lucky mean, so a mean above the threshold is only a
reason to look closer: fresh episodes, in stages, must confirm it. ``docs/measures.md`` has the
rule's error rates.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

AUTO = "auto"
PURPOSES = ("scheduled", "confirmation", "final")
"""What an evaluation episode is for, in the order of a trial's episodes in ``evaluations.csv``."""
STAGES = (20, 50, 100, 200, 500, 1000, 2000, 5000, 10**4, 10**5, 10**6)
"""The numbers of confirmation episodes after which the rule decides."""
FINAL_EPISODES = 20
"""The episodes of the final policy; the learned score is their mean."""
ERRORS = 4.0
"""Standard errors by which a confirmed mean exceeds the threshold."""
IMAGINED = 2
"""The imagined bad episodes among the confirmation episodes."""
REACH = 50.0
"""How far below the threshold an imagined episode is, in margins of the mean above it."""
NOT_NOW, UNDECIDED, LEARNED = -1, 0, 1


@lru_cache(maxsize=16)
def schedule(every: int | str, cap: int) -> NDArray[np.int64] | None:
    """The iterations of the evaluations of ``auto`` up to the cap; None for a number.

    Iteration 0, every 5 up to 50, then 10 % more each time, and the cap.

    >>> schedule("auto", 70).tolist()
    [0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 66, 70]
    """
    if every != AUTO:
        return None
    found = [i for i in range(0, 51, 5) if i < cap]
    while found[-1] >= 50 and (following := found[-1] * 11 // 10) < cap:
        found.append(following)
    return np.array([*found, cap], dtype=np.int64)


def evaluations_until(last: int, every: int | str, cap: int) -> NDArray[np.int64]:
    """The iterations of all evaluations of a trial that was stopped after ``last`` iterations."""
    if (fixed := schedule(every, cap)) is not None:
        return fixed[fixed <= last]
    found = np.arange(0, last + 1, int(every))
    return found if last < cap or found[-1] == cap else np.append(found, cap)


def stages(most: int) -> list[int]:
    """The numbers of confirmation episodes after which the rule decides, up to ``most``.

    >>> stages(300)
    [20, 50, 100, 200, 300]
    """
    return [*(n for n in STAGES if n < most), most]


def decide(
    scores: NDArray[np.float64], lowest: NDArray[np.float64], threshold: float, most: int
) -> NDArray[np.int8]:
    """Whether confirmation episodes show that the mean score exceeds the threshold.

    With n scores of mean m̄ > θ, two bad episodes are imagined beside them, of score

        b = max(lowest, θ - 50 (m̄ - θ))   if the trial ever scored at most θ, else the second.

    The trial has learned if, over all n + 2 scores with mean m and standard deviation s,

        m - 4 s / √(n + 2) > θ.

    Otherwise it goes on while m̄ > θ and ``most`` episodes could suffice, √most (m̄ - θ) > 4 s̄.

    The imagined episodes protect from failures too rare to be seen in n episodes: without a failure
    seen, n > 7.7 (1 + (θ - b) / (m̄ - θ)) episodes are needed.

    Args:
        scores: of the confirmation episodes of each trial [trials, n], n >= 2.
        lowest: the lowest score of the trial in any evaluation so far, these included [trials].
        threshold: θ.
        most: the largest number of confirmation episodes.

    Returns:
        LEARNED, UNDECIDED (play the episodes of the next stage) or NOT_NOW [trials].

    >>> decide(np.array([[500.0] * 20, [200.0] * 20, [9.0] * 20]), np.full(3, 9.0), 195, 500)
    array([ 1,  0, -1], dtype=int8)
    """
    n = scores.shape[1]
    mean = scores.mean(1)
    margin = mean - threshold
    bad = threshold - REACH * margin
    bad = np.where(lowest <= threshold, np.maximum(bad, lowest), bad)
    count = n + IMAGINED
    centre = (n * mean + IMAGINED * bad) / count
    own = ((scores - mean[:, None]) ** 2).sum(1)
    squares = own + n * (mean - centre) ** 2 + IMAGINED * (bad - centre) ** 2
    error = np.sqrt(squares / (count - 1) / count)
    learned = (margin > 0) & (centre - ERRORS * error > threshold)
    hope = np.sqrt(most) * margin > ERRORS * np.sqrt(own / (n - 1))
    undecided = (margin > 0) & hope & (n < most)
    return np.where(learned, LEARNED, np.where(undecided, UNDECIDED, NOT_NOW)).astype(np.int8)
