"""Copies of a gymnasium environment side by side, one for each trial; knows no torch.

The processes among which the copies may be divided import this package alone.
"""

from trl_explore.lanes.making import make_gym, reward_threshold
from trl_explore.lanes.vector import LaneVectorEnv

__all__ = ["LaneVectorEnv", "make_gym", "reward_threshold"]
