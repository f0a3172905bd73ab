"""Optimisers whose lanes never mix: a stopped trial's weights and momentum stay as they were."""

from trl_explore.optim.adam import LaneAdam
from trl_explore.optim.base import Parameters, TrialOptimizer, grouped
from trl_explore.optim.by_name import COUPLING, ELEMENTWISE, adam, torch_adam, torch_optimizer
from trl_explore.optim.lanes import LaneOptimizer
from trl_explore.optim.views import Views, all_finite

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
