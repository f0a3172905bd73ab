"""Environments: any gymnasium id as one TorchRL environment, with the lanes as batch dimension.

``make_env`` is imported on first use, so that worker processes can import ``envs.processes``
without torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from trl_explore.envs import tasks

if TYPE_CHECKING:
    from trl_explore.envs.make import lane_env, make_env
    from trl_explore.envs.vector import LaneVectorEnv

__all__ = ["LaneVectorEnv", "lane_env", "make_env"]

tasks.register()


def __getattr__(name: str) -> Any:
    if name in ("lane_env", "make_env"):
        from trl_explore.envs import make

        return getattr(make, name)
    if name == "LaneVectorEnv":
        from trl_explore.envs.vector import LaneVectorEnv

        return LaneVectorEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
