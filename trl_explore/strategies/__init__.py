"""Strategies: behaviour distributions μ(·|s) made from the output of a target policy."""

from trl_explore.strategies.classic import (
    Argmax,
    DecayingEpsilonGreedy,
    EpsilonGreedy,
    EpsilonSoftmax,
    FullMixture,
    MaxBoltzmann,
    Random,
    Softmax,
)
from trl_explore.strategies.continuous import ContinuousStrategy
from trl_explore.strategies.count_bonus import CountBonus
from trl_explore.strategies.discrete import Strategy, inverse_cdf
from trl_explore.strategies.epsilon_z_greedy import EpsilonZGreedy
from trl_explore.strategies.gaussian import (
    ContinuousMixture,
    ContinuousMixtureStrategy,
    EpsilonMean,
    EpsilonUniform,
    Gaussian,
    MeanAction,
    UniformAction,
)
from trl_explore.strategies.mixture import Mixture, MixtureStrategy, mixture_probs
from trl_explore.strategies.parameter_noise import ParameterNoise
from trl_explore.strategies.strategy import BaseStrategy
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
