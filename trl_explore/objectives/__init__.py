"""The REINFORCE loss, with off-policy corrections and baselines."""

from trl_explore.objectives.reinforce import ReinforceLoss

__all__ = ["ReinforceLoss"]
