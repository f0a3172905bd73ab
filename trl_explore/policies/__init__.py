"""Policies: (observation, trial) -> logits, with independent parameters for every trial."""

from trl_explore.policies.base import n_actions, n_features
from trl_explore.policies.initial import INITS, glorot_uniform, initial_weights
from trl_explore.policies.lanes import LaneLinear, LaneMLP
from trl_explore.policies.linear import LinearPolicy
from trl_explore.policies.mlp import MLPPolicy
from trl_explore.policies.tabular import TabularPolicy

__all__ = [
    "INITS",
    "LaneLinear",
    "LaneMLP",
    "LinearPolicy",
    "MLPPolicy",
    "TabularPolicy",
    "glorot_uniform",
    "initial_weights",
    "n_actions",
    "n_features",
]
