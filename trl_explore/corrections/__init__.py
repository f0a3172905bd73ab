"""Off-policy corrections: what a gradient of π may make of data that came from μ."""

from trl_explore.corrections.base import ImportanceWeights, NoCorrection, log_ratio_of
from trl_explore.corrections.behaviour import Behaviour, BehaviourActor
from trl_explore.corrections.per_decision import PerDecision
from trl_explore.corrections.per_step import PerStep
from trl_explore.corrections.trajectory import Trajectory

Correction = NoCorrection

__all__ = [
    "Behaviour",
    "BehaviourActor",
    "Correction",
    "ImportanceWeights",
    "NoCorrection",
    "PerDecision",
    "PerStep",
    "Trajectory",
    "log_ratio_of",
]
