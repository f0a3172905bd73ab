"""The REINFORCE loss, with its corrections for off-policy data and its baselines."""

from trl_explore.objectives.reinforce import ReinforceLoss

__all__ = ["ReinforceLoss"]
