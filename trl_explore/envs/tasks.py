"""Tasks for exploration, registered with gymnasium when ``trl_explore.envs`` is imported.

Each has a class that defines it, and a compiled kernel, in a module of ``envs.kernels``.
"""

from __future__ import annotations

import gymnasium as gym

NAMESPACE = "trl_explore"
TASKS = {  # name: its class, time limit, and the mean score that counts as solved
    "DeepSea-v0": ("deep_sea:DeepSea", None, 0.9),
    "RiverSwim-v0": ("tables:RiverSwim", 20, 2.5),
    "TwoRooms-v0": ("tables:TwoRooms", 100, 0.9),
    "SparseMountainCar-v0": ("mountain_car:SparseMountainCar", 1000, 0.9),
    "SwingUp-v0": ("swing_up:SwingUp", 200, 50.0),
    "Catch-v0": ("catch:Catch", None, 0.9),
}
"""Tasks without a time limit end by themselves."""


def register() -> None:
    """Register the tasks as ``trl_explore/NAME``.

    Example:
        >>> import trl_explore.envs
        >>> gym.make("trl_explore/DeepSea-v0", size=20).observation_space
        Discrete(400)
    """
    for name, (place, steps, threshold) in TASKS.items():
        gym.register(
            f"{NAMESPACE}/{name}",
            entry_point=f"trl_explore.envs.kernels.{place}",
            max_episode_steps=steps,
            reward_threshold=threshold,
        )
