"""Holding a kernel against the gymnasium environment that it stands for."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Discrete, flatten
from numpy.typing import NDArray

from trl_explore.envs.kernels.kernel import Kernel, kernel_of
from trl_explore.numerics.compiled.philox import STATE_SIZE, begin
from trl_explore.numerics.streams import Stream, generator, key


class CompiledEnv:
    """A kernel driven by hand, as the collector drives it.

    Args:
        kernel: the kernel.
        seed: seed of the random streams.
    """

    def __init__(self, kernel: Kernel, seed: int = 0) -> None:
        self.kernel = kernel
        self.key = key(seed, Stream.ENVIRONMENT)
        self.state = np.zeros(kernel.state_size)
        self.rng = np.zeros(STATE_SIZE, dtype=np.uint64)

    def begin(self, episode: int) -> NDArray[np.float32]:
        """Begin an episode; returns the first observation."""
        begin(self.rng, self.key, episode, 0)
        self.kernel.reset(self.kernel.parameters, self.state, self.rng)
        return self.observe()

    def step(self, action: int) -> tuple[NDArray[np.float32], float, bool]:
        """One step: observation, reward, terminated."""
        reward, terminated = self.kernel.step(self.kernel.parameters, self.state, action, self.rng)
        return self.observe(), reward, bool(terminated)

    def mask(self) -> NDArray[np.bool_] | None:
        """Which actions are allowed in the present state [n_actions]; None if all always are."""
        if self.kernel.mask is None:
            return None
        mask = np.ones(self.kernel.n_actions, dtype=np.bool_)
        self.kernel.mask(self.kernel.parameters, self.state, mask)
        return mask

    def observe(self) -> NDArray[np.float32]:
        """The observation in the present state [n_features]."""
        observation = np.full(self.kernel.n_features, np.nan, dtype=np.float32)
        self.kernel.observe(self.kernel.parameters, self.state, observation)
        return observation


def check_kernel(
    env: gym.Env[Any, Any], *, episodes: int = 100, max_steps: int = 500, seed: int = 0
) -> tuple[int, int]:
    """Step an environment and its kernel side by side with random actions and the same streams.

    Args:
        env: an instance of the environment, without wrappers that change it.
        episodes: how many episodes to compare.
        max_steps: after how many steps an episode is left.
        seed: seed of streams and actions.

    Returns:
        The number of transitions compared, and of episodes that terminated.

    Raises:
        AssertionError: at the first observation, mask, reward or termination that differs.
        LookupError: if the environment has no kernel.

    Example:
        >>> import gymnasium as gym
        >>> transitions, ends = check_kernel(gym.make("CartPole-v1").unwrapped, episodes=20)
        >>> ends
        20
    """
    compiled, space = CompiledEnv(kernel_of(env), seed), env.observation_space
    assert isinstance(env.action_space, Discrete), f"{env.action_space} is not Discrete"
    n_actions = int(env.action_space.n)
    assert compiled.kernel.n_actions == n_actions, f"{n_actions} actions"
    actions = np.random.default_rng(seed)
    transitions = ends = 0
    for episode in range(episodes):
        env.unwrapped.np_random = generator(seed, Stream.ENVIRONMENT, 0, episode)
        observation, info = env.reset()
        where = f"in episode {episode} at reset"
        np.testing.assert_array_equal(compiled.begin(episode), _flat(space, observation), where)
        _assert_same_mask(compiled.mask(), info, where)
        for t in range(max_steps):
            action = int(actions.integers(n_actions))
            observation, reward, terminated, _, info = env.step(action)
            ours, our_reward, our_terminated = compiled.step(action)
            where = f"in episode {episode} at step {t}, action {action}"
            np.testing.assert_array_equal(ours, _flat(space, observation), where)
            assert our_reward == reward, f"reward {our_reward}, not {reward}, {where}"
            assert our_terminated == terminated, f"terminated {our_terminated} {where}"
            _assert_same_mask(compiled.mask(), info, where)
            transitions += 1
            if terminated:
                ends += 1
                break
    return transitions, ends


def _assert_same_mask(ours: NDArray[np.bool_] | None, info: dict[str, Any], where: str) -> None:
    theirs = info.get("action_mask")
    assert (ours is None) == (theirs is None), f"mask {ours}, not {theirs}, {where}"
    if ours is not None:
        np.testing.assert_array_equal(ours, np.asarray(theirs, dtype=np.bool_), where)


def _flat(space: gym.Space[Any], observation: Any) -> NDArray[np.float32]:
    return np.asarray(flatten(space, observation), dtype=np.float32)
