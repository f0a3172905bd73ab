"""Strategies: what a policy's preferences become when actions are really drawn."""

from trl_explore.strategies.argmax import Argmax
from trl_explore.strategies.base import Strategy, inverse_cdf
from trl_explore.strategies.common import BaseStrategy
from trl_explore.strategies.continuous import (
    ContinuousMixture,
    ContinuousMixtureStrategy,
    ContinuousStrategy,
    EpsilonMean,
    EpsilonUniform,
    Gaussian,
    MeanAction,
    UniformAction,
)
from trl_explore.strategies.epsilon_greedy import DecayingEpsilonGreedy, EpsilonGreedy
from trl_explore.strategies.mixture import Mixture, MixtureStrategy, mixture_probs
from trl_explore.strategies.random import Random
from trl_explore.strategies.softmax import Softmax

__all__ = [
    "Argmax",
    "BaseStrategy",
    "ContinuousMixture",
    "ContinuousMixtureStrategy",
    "ContinuousStrategy",
    "DecayingEpsilonGreedy",
    "EpsilonGreedy",
    "EpsilonMean",
    "EpsilonUniform",
    "Gaussian",
    "MeanAction",
    "Mixture",
    "MixtureStrategy",
    "Random",
    "Softmax",
    "Strategy",
    "UniformAction",
    "inverse_cdf",
    "mixture_probs",
]
