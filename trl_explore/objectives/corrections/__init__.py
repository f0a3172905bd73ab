"""Off-policy corrections: policy gradients from data collected with μ."""

from trl_explore.objectives.corrections.behaviour import Behaviour
from trl_explore.objectives.corrections.correction import (
    ImportanceWeights,
    NoCorrection,
    as_correction,
    log_ratio_of,
)
from trl_explore.objectives.corrections.importance import AsIf, PerDecision, PerStep, Trajectory

Correction = NoCorrection

__all__ = [
    "AsIf",
    "Behaviour",
    "Correction",
    "ImportanceWeights",
    "NoCorrection",
    "PerDecision",
    "PerStep",
    "Trajectory",
    "as_correction",
    "log_ratio_of",
]
