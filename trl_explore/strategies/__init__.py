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
from trl_explore.strategies.count_bonus import CountBonus
from trl_explore.strategies.epsilon_greedy import DecayingEpsilonGreedy, EpsilonGreedy
from trl_explore.strategies.epsilon_softmax import EpsilonSoftmax
from trl_explore.strategies.epsilon_z_greedy import EpsilonZGreedy
from trl_explore.strategies.full_mixture import FullMixture
from trl_explore.strategies.max_boltzmann import MaxBoltzmann
from trl_explore.strategies.mixture import Mixture, MixtureStrategy, mixture_probs
from trl_explore.strategies.parameter_noise import ParameterNoise
from trl_explore.strategies.random import Random
from trl_explore.strategies.softmax import Softmax
from trl_explore.strategies.vdbe import VDBE

__all__ = [
    "VDBE",
    "Argmax",
    "BaseStrategy",
    "ContinuousMixture",
    "ContinuousMixtureStrategy",
    "ContinuousStrategy",
    "CountBonus",
    "DecayingEpsilonGreedy",
    "EpsilonGreedy",
    "EpsilonMean",
    "EpsilonSoftmax",
    "EpsilonUniform",
    "EpsilonZGreedy",
    "FullMixture",
    "Gaussian",
    "MaxBoltzmann",
    "MeanAction",
    "Mixture",
    "MixtureStrategy",
    "ParameterNoise",
    "Random",
    "Softmax",
    "Strategy",
    "UniformAction",
    "inverse_cdf",
    "mixture_probs",
]
