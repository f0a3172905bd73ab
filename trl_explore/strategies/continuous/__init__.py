"""Strategies over vectors of real numbers: what becomes of a Gaussian policy."""

from trl_explore.strategies.continuous.base import ContinuousStrategy
from trl_explore.strategies.continuous.epsilon import EpsilonMean, EpsilonUniform
from trl_explore.strategies.continuous.gaussian import Gaussian
from trl_explore.strategies.continuous.mean_action import MeanAction
from trl_explore.strategies.continuous.mixture import ContinuousMixture, ContinuousMixtureStrategy
from trl_explore.strategies.continuous.uniform_action import UniformAction

__all__ = [
    "ContinuousMixture",
    "ContinuousMixtureStrategy",
    "ContinuousStrategy",
    "EpsilonMean",
    "EpsilonUniform",
    "Gaussian",
    "MeanAction",
    "UniformAction",
]
