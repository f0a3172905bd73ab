"""Policies: (observation, trial) -> logits, or loc and scale; each trial has its own parameters."""

from trl_explore.policies.gaussian import GaussianLinearPolicy, GaussianMLPPolicy, LaneGaussian
from trl_explore.policies.layers import (
    INITS,
    LaneLinear,
    LaneMLP,
    initial_weights,
    n_actions,
    n_dims,
    n_features,
)
from trl_explore.policies.softmax import LinearPolicy, MLPPolicy, TabularPolicy

__all__ = [
    "INITS",
    "GaussianLinearPolicy",
    "GaussianMLPPolicy",
    "LaneGaussian",
    "LaneLinear",
    "LaneMLP",
    "LinearPolicy",
    "MLPPolicy",
    "TabularPolicy",
    "initial_weights",
    "n_actions",
    "n_dims",
    "n_features",
]
