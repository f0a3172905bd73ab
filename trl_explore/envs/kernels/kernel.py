"""Compiled environments: definition, registry, and comparison with gymnasium's."""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Discrete, flatten
from numba.extending import is_jitted
from numpy.typing import NDArray

from trl_explore.numerics.compiled.philox import STATE_SIZE, begin
from trl_explore.numerics.streams import Stream, generator, key

Function = Any
_NUMBER = (str, int, float, np.generic)


@dataclass(frozen=True)
class Kernel:
    """The dynamics of one environment as three compiled functions (``numba.njit``).

    They must do the same as the gymnasium environment, and draw the same random numbers: one call
    of ``kernels.random(rng)`` for each ``np_random.random()``, in the same order.

        reset(parameters, state, rng)                 begins an episode: fills ``state``
        step(parameters, state, action, rng)          updates ``state``; returns reward, terminated
        observe(parameters, state, observation)       fills ``observation`` [n_features] float32

    The collector applies time limits.

    Attributes:
        reset, step, observe: see above.
        parameters: a tuple of numbers and arrays, the constants of an environment instance; passed
            to each function unchanged.
        state_size: length of ``state``, a float64 array.
        n_features: length of an observation.
        n_actions: number of actions.
        mask: ``mask(parameters, state, mask)`` fills a bool array [n_actions], False where an
            action is not allowed; None: all actions are always allowed.
    """

    reset: Function
    step: Function
    observe: Function
    parameters: tuple[Any, ...]
    state_size: int
    n_features: int
    n_actions: int
    mask: Function | None = None

    @property
    def functions(self) -> tuple[Function, ...]:
        """The compiled functions."""
        own = (self.reset, self.step, self.observe)
        return own if self.mask is None else (*own, self.mask)

    def __post_init__(self) -> None:
        for function in self.functions:
            if not is_jitted(function):
                raise ValueError(f"{function} is not compiled; decorate it with kernel_function")
            if function.py_func.__closure__:
                name = function.py_func.__qualname__
                raise ValueError(f"{name} closes over values; pass them in parameters")

    @property
    def digest(self) -> str:
        """A hash of the source files and constants that the functions are compiled from.

        It determines which compiled code on disk may be reused.
        """
        functions = self.functions
        files: set[str] = set()
        constants: set[str] = set()
        for function in functions:
            _add_sources(function, files, constants, set())
        names = [f"{f.py_func.__module__}.{f.py_func.__qualname__}" for f in functions]
        sources = (Path(file).read_text(encoding="utf-8") for file in sorted(files))
        return hashlib.sha256(
            "\0".join((*names, *sources, *sorted(constants))).encode()
        ).hexdigest()


def _add_sources(function: Any, files: set[str], constants: set[str], seen: set[int]) -> None:
    """Add the files of a compiled function and of those it calls, and the constants they read."""
    if id(function) in seen:
        return
    seen.add(id(function))
    python = function.py_func
    files.add(inspect.getsourcefile(python) or "")
    names = python.__code__.co_names
    found = {name: python.__globals__[name] for name in names if name in python.__globals__}
    for module in [value for value in found.values() if inspect.ismodule(value)]:
        found |= {f"{module.__name__}.{n}": getattr(module, n) for n in names if hasattr(module, n)}
    for name, value in found.items():
        if is_jitted(value):
            _add_sources(value, files, constants, seen)
        elif isinstance(value, np.ndarray):
            constants.add(f"{name}: {value.dtype} {value.shape} {value.tobytes().hex()}")
        elif all(isinstance(v, _NUMBER) for v in (value if type(value) is tuple else [value])):
            constants.add(f"{name}: {value!r}")


_BUILDERS: dict[type[gym.Env], Callable[[Any], Kernel]] = {}
_METHODS: dict[type[gym.Env], dict[str, Function]] = {}
"""The methods that a class had when its kernel was registered."""


def register_kernel(
    env_class: type[gym.Env],
) -> Callable[[Callable[[Any], Kernel]], Callable[[Any], Kernel]]:
    """Decorator: register a function that builds the kernel of an instance of ``env_class``.

    The function takes the unwrapped environment and reads the kernel's parameters from it. The
    kernel belongs to the present methods of the class: if one is replaced later, there is none.
    """

    def register(builder: Callable[[Any], Kernel]) -> Callable[[Any], Kernel]:
        _BUILDERS[env_class], _METHODS[env_class] = builder, _methods(env_class)
        return builder

    return register


def kernel_of(env: gym.Env) -> Kernel:
    """The kernel of an environment instance.

    Raises:
        LookupError: with the reason, if there is none or it does not support this instance.
    """
    env = env.unwrapped
    kind = type(env)
    builder = _BUILDERS.get(kind)
    if builder is None:
        raise LookupError(f"no kernel is registered for {kind.__name__}")
    now = _methods(kind)
    for name, method in _METHODS.get(kind, {}).items():
        replaced = now.get(name) is not method or name in vars(env)
        if replaced or (kind.__module__.startswith("gymnasium.") and not _from_file(kind, method)):
            raise LookupError(f"{kind.__name__}.{name} has been replaced")
    return builder(env)


def _methods(kind: type[gym.Env]) -> dict[str, Function]:
    """The methods of a class that may change an episode, those of its parents included."""
    found = {
        name: getattr(kind, name, None) for name in dir(kind) if name not in ("render", "close")
    }
    return {name: method for name, method in found.items() if inspect.isfunction(method)}


def _from_file(kind: type[gym.Env], method: Function) -> bool:
    """Whether a method is written in the file of the class or of a parent.

    An environment of gymnasium may have been changed before its kernel was registered.
    """
    files = {getattr(sys.modules.get(c.__module__), "__file__", None) for c in kind.__mro__}
    return method.__code__.co_filename in files


class CompiledEnv:
    """A kernel that Python code can step, with the random streams of the collector.

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
        """The actions allowed in the current state [n_actions]; None if the kernel has no mask."""
        if self.kernel.mask is None:
            return None
        mask = np.ones(self.kernel.n_actions, dtype=np.bool_)
        self.kernel.mask(self.kernel.parameters, self.state, mask)
        return mask

    def observe(self) -> NDArray[np.float32]:
        """The observation in the current state [n_features]."""
        observation = np.full(self.kernel.n_features, np.nan, dtype=np.float32)
        self.kernel.observe(self.kernel.parameters, self.state, observation)
        return observation


def check_kernel(
    env: gym.Env[Any, Any], *, episodes: int = 100, max_steps: int = 500, seed: int = 0
) -> tuple[int, int]:
    """Step an environment and its kernel side by side with random actions and the same streams.

    Args:
        env: an instance of the environment, without wrappers that change it.
        episodes: the number of episodes to compare.
        max_steps: the number of steps after which an episode is abandoned.
        seed: seed of streams and actions.

    Returns:
        The number of transitions compared, and the number of episodes that terminated.

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
