"""Baselines b_t, subtracted from the return; each uses the trial's own data only."""

from trl_explore.objectives.baselines.baseline import Baseline, Constant, EpisodeMean, as_baseline
from trl_explore.objectives.baselines.leave_one_out import LeaveOneOut
from trl_explore.objectives.baselines.linear_value import LinearValue
from trl_explore.objectives.baselines.step_mean import StepMean

__all__ = [
    "Baseline",
    "Constant",
    "EpisodeMean",
    "LeaveOneOut",
    "LinearValue",
    "StepMean",
    "as_baseline",
]
