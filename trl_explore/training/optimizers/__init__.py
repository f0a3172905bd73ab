"""Optimisers whose lanes never mix: a stopped trial's weights and momentum stay as they were."""

from trl_explore.training.optimizers.adam import LaneAdam
from trl_explore.training.optimizers.by_name import (
    COUPLING,
    ELEMENTWISE,
    adam,
    torch_adam,
    torch_optimizer,
)
from trl_explore.training.optimizers.optimizer import (
    LaneOptimizer,
    Parameters,
    TrialOptimizer,
    Views,
    all_finite,
    grouped,
)

__all__ = [
    "COUPLING",
    "ELEMENTWISE",
    "LaneAdam",
    "LaneOptimizer",
    "Parameters",
    "TrialOptimizer",
    "Views",
    "adam",
    "all_finite",
    "grouped",
    "torch_adam",
    "torch_optimizer",
]
