"""Optimisers whose lanes never mix: a stopped trial's weights and momentum stay as they were."""

from trl_explore.training.optimizers.adam import LaneAdam
from trl_explore.training.optimizers.optimizer import (
    COUPLING,
    ELEMENTWISE,
    LaneOptimizer,
    Parameters,
    TrialOptimizer,
    Views,
    all_finite,
    grouped,
    torch_optimizer,
)

__all__ = [
    "COUPLING",
    "ELEMENTWISE",
    "LaneAdam",
    "LaneOptimizer",
    "Parameters",
    "TrialOptimizer",
    "Views",
    "all_finite",
    "grouped",
    "torch_optimizer",
]
