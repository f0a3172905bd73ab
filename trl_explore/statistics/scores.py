"""Comparison of scores: what remains to compare where no configuration reaches the threshold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trl_explore.statistics.bootstrap import RESAMPLES, streams
from trl_explore.statistics.comparisons import holm, mean_difference
from trl_explore.statistics.estimates import LEVEL, Estimate, flat
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.statistics.pairing import pair_indices, refuse_shared


@dataclass(frozen=True)
class ScoreComparison:
    """Comparison of the scores of configurations ``a`` and ``b``, on their common trials.

    Attributes:
        a: name of the first configuration.
        b: name of the second.
        design: ``paired`` by seed and trial index, or ``unpaired`` if there are no common trials.
        n: number of pairs, or of trials of the smaller configuration.
        mean_a: mean score of a over the compared trials.
        mean_b: the same for b.
        difference: mean_a - mean_b with its interval; positive: a scores more.
        p_value: two-sided.
        p_holm: ``p_value`` after Holm's correction for all pairs of the table.

    """

    a: str
    b: str
    design: str
    n: int
    mean_a: float
    mean_b: float
    difference: Estimate
    p_value: float
    p_holm: float

    @property
    def winner(self) -> str | None:
        """The configuration with the higher score if interval and corrected test exclude zero."""
        if not self.p_holm <= 1.0 - self.difference.level + 1e-12:
            return None
        above, below = self.difference.above(0.0), self.difference.below(0.0)
        return self.a if above else self.b if below else None

    def row(self) -> dict[str, Any]:
        """Flat dictionary for a table; each estimate as ``x``, ``x_low``, ``x_high``."""
        return flat(vars(self)) | {"winner": self.winner}


def compare_scores(
    pairs: Sequence[tuple[Outcomes, Outcomes]],
    rng: np.random.Generator,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
) -> list[ScoreComparison]:
    """Compare the final scores of planned pairs, with ``p_holm`` over these pairs.

    Scores need no threshold, so configurations with different caps or thresholds can be compared.
    Trials without a finite score are left out.

    Raises:
        ValueError: the same trials of the same configuration on both sides, or no finite score.

    """
    rngs = streams(rng, [f"{a.name} | {b.name}" for a, b in pairs])
    tail = len(pairs) > (1.0 - level) * (1 + resamples)
    found = []
    for a, b in pairs:
        refuse_shared([a, b])
        i, j = pair_indices(a, b)
        paired = len(i) > 0
        x, y = (a.score[i], b.score[j]) if paired else (a.score, b.score)
        if paired:
            both = np.isfinite(x) & np.isfinite(y)
            x, y = x[both], y[both]
        else:
            x, y = x[np.isfinite(x)], y[np.isfinite(y)]
        if not len(x) or not len(y):
            raise ValueError(f"{a.name} and {b.name}: no finite scores to compare")
        d = mean_difference(
            x, y, rngs[f"{a.name} | {b.name}"], paired=paired, level=level, resamples=resamples,
            tail=tail,
        )  # fmt: skip
        found.append(
            ScoreComparison(
                a=a.name,
                b=b.name,
                design="paired" if paired else "unpaired",
                n=d.n,
                mean_a=float(x.mean()),
                mean_b=float(y.mean()),
                difference=d.estimate,
                p_value=d.p_value,
                p_holm=d.p_value,
            )
        )
    corrected = holm([c.p_value for c in found])
    return [replace(c, p_holm=float(p)) for c, p in zip(found, corrected, strict=True)]
