"""CliffWalking (Sutton & Barto 2018, example 6.6), slippery or not."""

from __future__ import annotations

from gymnasium.envs.toy_text.cliffwalking import CliffWalkingEnv

from trl_explore.kernels.base import Kernel, register_kernel
from trl_explore.kernels.tabular import tabular


@register_kernel(CliffWalkingEnv)
def cliff_walking(env: CliffWalkingEnv) -> Kernel:
    """The kernel of a CliffWalking environment, from its table of transitions."""
    return tabular(env.P, env.initial_state_distrib)
