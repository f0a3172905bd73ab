"""Environments: any gymnasium id as one TorchRL environment, with the lanes as batch dimension.

Importing this package registers the tasks for exploration with gymnasium, as ``trl_explore/NAME``.
``make_env`` is imported on first use, so that worker processes can import ``envs.processes``
without torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium as gym

if TYPE_CHECKING:
    from trl_explore.envs.make import lane_env, make_env
    from trl_explore.envs.vector import LaneVectorEnv

__all__ = ["LaneVectorEnv", "lane_env", "make_env"]

NAMESPACE = "trl_explore"
TASKS = {
    "DeepSea-v0": ("bsuite:DeepSea", None, 0.9),
    "RiverSwim-v0": ("tables:RiverSwim", 20, 2.5),
    "TwoRooms-v0": ("tables:TwoRooms", 100, 0.9),
    "SparseMountainCar-v0": ("classic_control:SparseMountainCar", 1000, 0.9),
    "SwingUp-v0": ("swing_up:SwingUp", 200, 50.0),
    "Catch-v0": ("bsuite:Catch", None, 0.9),
}
"""Name -> class, in a module of ``envs.kernels`` with its kernel; time limit (None: it ends by
itself); and the mean score that counts as solved."""

for _name, (_class, _steps, _threshold) in TASKS.items():
    gym.register(
        f"{NAMESPACE}/{_name}",
        entry_point=f"trl_explore.envs.kernels.{_class}",
        max_episode_steps=_steps,
        reward_threshold=_threshold,
    )


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("trl_explore.envs.make"), name)
