"""Environments: any gymnasium id as one TorchRL environment whose batch dimension is the lanes."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from torchrl.envs import Compose, EnvBase, RewardSum, StepCounter, TransformedEnv
from torchrl.envs.libs.gym import GymWrapper

from trl_explore.checks import LARGEST, check_integer, first_line
from trl_explore.streams import Stream, generator


def make_gym(id: str, max_steps: int | None, kwargs: Mapping[str, Any]) -> gym.Env:
    """One gymnasium environment with a flat Box observation and a Discrete action.

    Raises:
        ValueError: if the id is unknown, an extra of gymnasium is not installed, a constructor
            argument is refused, or the spaces are not of the supported kinds.
    """
    if max_steps is not None:
        check_integer("max_steps", max_steps, 1, 10**9)
    env = _construct(id, max_steps, kwargs)
    _check_actions(id, env.action_space)
    space = env.observation_space
    if isinstance(space, spaces.Discrete) or (
        isinstance(space, spaces.Box) and len(space.shape) != 1
    ):
        env = gym.wrappers.FlattenObservation(env)  # one-hot, or the array as a vector
    elif not isinstance(space, spaces.Box):
        raise ValueError(
            f"environment {id!r} has observation space {space}; Box or Discrete is needed"
        )
    if env.observation_space.dtype != np.float32:
        env = gym.wrappers.DtypeObservation(env, np.float32)
    return env


def _check_actions(id: str, space: spaces.Space[Any]) -> None:
    if isinstance(space, spaces.Discrete):
        if space.start != 0:
            raise ValueError(f"environment {id!r} numbers its actions from {space.start}")
    elif not (
        isinstance(space, spaces.Box)
        and len(space.shape) == 1
        and np.issubdtype(space.dtype, np.floating)
    ):
        raise ValueError(
            f"environment {id!r} has action space {space}; "
            "Discrete, or a Box with one dimension of floats, is needed"
        )


def _construct(id: str, max_steps: int | None, kwargs: Mapping[str, Any]) -> gym.Env:
    """Build it; an error of its constructor, whatever it is, becomes one line."""
    try:
        with warnings.catch_warnings(record=True) as caught:
            env = gym.make(id, max_episode_steps=max_steps, disable_env_checker=True, **kwargs)
    except gym.error.DependencyNotInstalled as error:
        raise ValueError(f"environment {id!r} needs a package: {first_line(error)}") from error
    except (gym.error.Error, ModuleNotFoundError) as error:
        raise ValueError(f"unknown environment id {id!r}: {first_line(error)}") from error
    except Exception as error:
        raise ValueError(
            f"environment {id!r} refuses its arguments: {type(error).__name__}: {first_line(error)}"
        ) from error
    for warning in caught:
        warnings.warn(warning.message, warning.category, stacklevel=2)
    return env


class LaneVectorEnv(VectorEnv):
    """n independent copies of a gymnasium environment, each stepped only while it is unfinished.

    Differs from gymnasium's vector environments in what a laboratory of independent trials needs:
    a finished lane stays finished, is never stepped, and keeps its last observation, until it is
    reset by ``options["reset_mask"]`` (autoreset is disabled); every episode of every lane draws
    from a stream of its own, ``streams.generator(seed, ENVIRONMENT, trial, episode)``, so that an
    episode depends on nothing but its trial, its number and the actions.

    Args:
        id: gymnasium id.
        num_envs: number of lanes.
        max_steps: time limit of an episode in steps; None takes the one that gymnasium registers.
        seed: seed of the job.
        first_trial: trial index of lane 0.
        kwargs: arguments of the environment's constructor.
        stream: from which of the trials' streams the environment draws.
    """

    def __init__(
        self,
        id: str,
        num_envs: int,
        max_steps: int | None = None,
        *,
        seed: int = 0,
        first_trial: int = 0,
        kwargs: Mapping[str, Any] | None = None,
        stream: Stream = Stream.ENVIRONMENT,
    ) -> None:
        check_integer("num_envs", num_envs, 1)
        check_integer("first_trial", first_trial, 0, LARGEST - num_envs)
        check_integer("seed", seed, 0)
        kwargs = dict(kwargs or {})
        # A collector that compiles the environment never steps the lanes: build them when needed.
        env = make_gym(id, max_steps, kwargs)
        self.envs: list[gym.Env] = [env]
        self.id, self.kwargs = id, kwargs
        limit = env.spec.max_episode_steps if env.spec is not None else max_steps
        if limit is None:
            raise ValueError(f"environment {id!r} has no time limit of its own; set max_steps")
        self.max_steps = limit
        self.num_envs = num_envs
        self.spec = env.spec
        self.metadata = {**env.metadata, "autoreset_mode": AutoresetMode.DISABLED}
        self.autoreset_mode = AutoresetMode.DISABLED
        self.single_observation_space = env.observation_space
        self.single_action_space = env.action_space
        self.observation_space = batch_space(env.observation_space, num_envs)
        self.action_space = batch_space(env.action_space, num_envs)
        self.first_trial = first_trial
        self.stream = stream
        self.reseed(seed)
        shape = (num_envs, *(env.observation_space.shape or ()))
        self._observations = np.zeros(shape, dtype=env.observation_space.dtype)
        self._terminated = np.zeros(num_envs, dtype=np.bool_)
        self._truncated = np.zeros(num_envs, dtype=np.bool_)
        self._running = np.zeros(num_envs, dtype=np.bool_)

    def reseed(self, seed: int) -> None:
        """Start every lane again at episode 0 of its trial under ``seed``."""
        generator(seed, self.stream, 0)  # raises if the seed is not valid
        self.seed = int(seed)
        self.episodes = np.zeros(self.num_envs, dtype=np.int64)

    @property
    def running(self) -> NDArray[np.bool_]:
        """Whether the lane is within an episode [num_envs]."""
        return self._running

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin the next episode of the lanes in ``options["reset_mask"]``, or of all."""
        if seed is not None:
            self.reseed(seed)
        while len(self.envs) < self.num_envs:
            self.envs.append(make_gym(self.id, self.max_steps, self.kwargs))
        mask = (options or {}).get("reset_mask")
        lanes = range(self.num_envs) if mask is None else np.flatnonzero(mask)
        for lane in lanes:
            env = self.envs[lane]
            trial, episode = self.first_trial + int(lane), int(self.episodes[lane])
            env.unwrapped.np_random = generator(self.seed, self.stream, trial, episode)
            self._observations[lane] = env.reset()[0]
            self.episodes[lane] += 1
            self._terminated[lane] = self._truncated[lane] = False
            self._running[lane] = True
        return self._observations.copy(), {}

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[
        NDArray[Any], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]
    ]:
        """Step the unfinished lanes; a finished one repeats its last observation with reward 0."""
        space = self.single_action_space
        if isinstance(space, spaces.Box):
            actions = np.clip(actions, space.low, space.high)
        rewards = np.zeros(self.num_envs)
        for lane in np.flatnonzero(self._running).tolist():
            observation, rewards[lane], terminated, truncated, _ = self.envs[lane].step(
                actions[lane]
            )
            self._observations[lane] = observation
            if terminated or truncated:
                self._terminated[lane], self._truncated[lane] = terminated, truncated
                self._running[lane] = False
        return (
            self._observations.copy(),
            rewards,
            self._terminated.copy(),
            self._truncated.copy(),
            {},
        )

    def close_extras(self, **kwargs: Any) -> None:
        """Close every lane."""
        for env in self.envs:
            env.close()


def make_env(
    id: str = "CartPole-v1",
    trials: int = 1,
    max_steps: int | None = None,
    *,
    seed: int = 0,
    first_trial: int = 0,
    kwargs: Mapping[str, Any] | None = None,
    stream: Stream = Stream.ENVIRONMENT,
) -> TransformedEnv:
    """Any gymnasium environment as a TorchRL environment with batch size [trials].

    ``GymWrapper`` over ``LaneVectorEnv``, with the transforms ``StepCounter`` ("step_count") and
    ``RewardSum`` ("episode_reward"). Observations are a vector: a Box is flattened, a Discrete one
    becomes one-hot. Actions are indices.

    Args:
        id: gymnasium id.
        trials: number of lanes.
        max_steps: time limit of an episode; None takes the registered one.
        seed: seed of the job.
        first_trial: trial index of lane 0.
        kwargs: arguments of the environment's constructor.
        stream: from which of the trials' streams the environment draws.

    Raises:
        ValueError: if the environment does not exist, is not of a kind served, or has no limit.

    Example:
        >>> make_env("CartPole-v1", trials=3).rollout(2)["observation"].shape
        torch.Size([3, 2, 4])
    """
    lanes = LaneVectorEnv(
        id, trials, max_steps, seed=seed, first_trial=first_trial, kwargs=kwargs, stream=stream
    )
    env = GymWrapper(lanes, categorical_action_encoding=True)
    transforms = [StepCounter(), RewardSum()]
    return TransformedEnv(env, Compose(*transforms))


def lane_env(env: EnvBase) -> LaneVectorEnv:
    """The lanes within an environment of ``make_env``.

    Raises:
        ValueError: if the environment has none.
    """
    lanes = getattr(getattr(env, "base_env", env), "_env", None)
    if not isinstance(lanes, LaneVectorEnv):
        raise ValueError("the environment has no lanes; build it with trl_explore.envs.make_env")
    return lanes
