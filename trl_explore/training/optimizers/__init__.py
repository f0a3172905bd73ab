"""Optimisers that keep trials independent: a stopped trial's weights and momentum do not change."""

from trl_explore.training.optimizers.adam import LaneAdam
from trl_explore.training.optimizers.optimizer import (
    COUPLING,
    ELEMENTWISE,
    LaneOptimizer,
    TrialOptimizer,
    Views,
    all_finite,
    torch_optimizer,
)

__all__ = [
    "COUPLING",
    "ELEMENTWISE",
    "LaneAdam",
    "LaneOptimizer",
    "TrialOptimizer",
    "Views",
    "all_finite",
    "torch_optimizer",
]
