"""Baselines b_t, subtracted from the return; each uses the trial's own data only."""

from trl_explore.objectives.baselines.baseline import (
    Baseline,
    Constant,
    EpisodeMean,
    LeaveOneOut,
    StepMean,
)
from trl_explore.objectives.baselines.linear_value import LinearValue

__all__ = [
    "Baseline",
    "Constant",
    "EpisodeMean",
    "LeaveOneOut",
    "LinearValue",
    "StepMean",
]
