"""FrozenLake, on any map, slippery or not."""

from __future__ import annotations

from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv

from trl_explore.kernels.base import Kernel, register_kernel
from trl_explore.kernels.tabular import tabular


@register_kernel(FrozenLakeEnv)
def frozen_lake(env: FrozenLakeEnv) -> Kernel:
    """The kernel of a FrozenLake environment, from its table of transitions."""
    return tabular(env.P, env.initial_state_distrib)
