"""An environment whose steps take as long as a file says, so that a job can be met midway.

``TRL_EXPLORE_WAIT`` names the file, which holds the seconds of a step. Results do not depend on it.
"""

import os
import time
from pathlib import Path

import gymnasium as gym
import numpy as np

FILE = os.environ.get("TRL_EXPLORE_WAIT")


class Waiting(gym.Env):
    """Episodes of four steps; action 1 pays one."""

    observation_space = gym.spaces.Box(-1, 1, (2,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left = 4
        return self._look(), {}

    def step(self, action):
        if FILE:
            time.sleep(float(Path(FILE).read_text()))
        self.left -= 1
        return self._look(), float(action), self.left == 0, False, {}

    def _look(self):
        return self.np_random.uniform(-1, 1, 2).astype(np.float32)


gym.register("Waiting-v0", entry_point=Waiting, max_episode_steps=4)
