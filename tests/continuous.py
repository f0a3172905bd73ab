"""Strategies, policies and an environment with continuous actions."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from hydra.utils import instantiate
from omegaconf import OmegaConf
from tensordict.nn import TensorDictSequential

from trl_explore.collectors import TorchRLCollector
from trl_explore.config import CONF
from trl_explore.config.checking import options
from trl_explore.envs import make_env
from trl_explore.policies import GaussianLinearPolicy, GaussianMLPPolicy

STRATEGIES = options("strategy", "continuous")
BOTH = [GaussianLinearPolicy, GaussianMLPPolicy]


class Target(gym.Env):
    """In every step, reach (x, 1/2) from the observation x; the reward is − distance²."""

    observation_space = spaces.Box(-1, 1, (1,), np.float32)
    action_space = spaces.Box(-2, 2, (2,), np.float32)

    def reset(self, *, seed=None, options=None):
        return self.new(), {}

    def new(self):
        self.x = self.np_random.uniform(-1, 1, 1).astype(np.float32)
        return self.x

    def step(self, action):
        assert self.action_space.contains(action)
        distance = action - np.array([self.x[0], 0.5])
        return self.new(), -float((distance**2).sum()), False, False, {}


def strategy_of(name):
    return instantiate(OmegaConf.load(CONF / "strategy" / f"{name}.yaml"), _convert_="all")


def collector_of(strategy, policy=GaussianLinearPolicy, trials=3, first_trial=0, **wanted):
    max_steps = wanted.pop("max_steps", 30)
    streams = {"seed": 2, "first_trial": first_trial}
    env = make_env("Pendulum-v1", trials, max_steps, **streams)
    built = policy(env, **streams, **wanted)
    return TorchRLCollector(env, TensorDictSequential(built, strategy))
