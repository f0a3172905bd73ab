"""Compiled dynamics of well-known environments, each tested against gymnasium.

An environment of your own takes three functions and a maker, in any module that is imported
before the collector is built:

    @kernel_function
    def reset(parameters, state, rng): state[0] = random(rng)

    @kernel_function
    def step(parameters, state, action, rng): ...; return reward, terminated

    @kernel_function
    def observe(parameters, state, observation): observation[0] = state[0]

    @register_kernel(MyEnv)
    def my_env(env):
        return Kernel(reset, step, observe, (env.size,), state_size=1, n_features=1, n_actions=2)
"""

from trl_explore.kernels import cartpole, frozen_lake
from trl_explore.kernels.base import Kernel, kernel_function, kernel_of, register_kernel
from trl_explore.kernels.philox import random

__all__ = [
    "Kernel",
    "cartpole",
    "frozen_lake",
    "kernel_function",
    "kernel_of",
    "random",
    "register_kernel",
]
