"""Taxi (Dietterich 2000, section 3.1), in rain or not, with its action mask."""

from __future__ import annotations

import numpy as np
from gymnasium.envs.toy_text.taxi import TaxiEnv

from trl_explore.kernels.base import Kernel, register_kernel
from trl_explore.kernels.tabular import tabular


@register_kernel(TaxiEnv)
def taxi(env: TaxiEnv) -> Kernel:
    """The kernel of a Taxi environment, from its tables of transitions and masks.

    Raises:
        LookupError: if the passenger is fickle: its choice of a destination draws an integer.
    """
    if env.fickle_passenger:
        raise LookupError("the kernel of Taxi does not serve fickle_passenger=True")
    masks = np.array([env.action_mask(state) for state in range(len(env.P))], dtype=np.bool_)
    return tabular(env.P, env.initial_state_distrib, masks)
