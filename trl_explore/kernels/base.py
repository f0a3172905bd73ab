"""What a compiled environment is, and the table of those that exist."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numba as nb

Function = Callable[..., Any]

kernel_function = nb.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
"""Decorator of a kernel's functions: compiled into the loop that calls them, kept on disk."""


@dataclass(frozen=True)
class Kernel:
    """The dynamics of one environment as three compiled functions (``numba.njit``).

    Together they must do what the gymnasium environment does, drawing the same random numbers
    from ``rng`` by ``kernels.random(rng)`` in the same order as it calls ``np_random.random()``:

        reset(parameters, state, rng)                 begins an episode: fills ``state``
        step(parameters, state, action, rng)          moves ``state``; returns reward, terminated
        observe(parameters, state, observation)       fills ``observation`` [n_features] float32

    Time limits are the collector's business.

    Attributes:
        reset: see above.
        step: see above.
        observe: see above.
        parameters: a tuple of numbers and arrays, what an instance of the environment was built
            with; handed to each function as it is.
        state_size: length of ``state``, a float64 array.
        n_features: length of an observation.
        n_actions: number of actions.
    """

    reset: Function
    step: Function
    observe: Function
    parameters: tuple[Any, ...]
    state_size: int
    n_features: int
    n_actions: int

    @property
    def digest(self) -> str:
        """A fingerprint of the three functions' source files, which decides what may be reused."""
        functions = (self.reset, self.step, self.observe)
        files = {inspect.getsourcefile(f.py_func): f for f in functions}  # type: ignore[attr-defined]
        text = [inspect.getsource(inspect.getmodule(f.py_func)) for f in files.values()]  # type: ignore[attr-defined, arg-type]
        names = [f"{f.py_func.__module__}.{f.py_func.__qualname__}" for f in functions]  # type: ignore[attr-defined]
        return hashlib.sha256("\0".join([*names, *text]).encode()).hexdigest()


_BUILDERS: dict[type[gym.Env], Callable[[Any], Kernel]] = {}


def register_kernel(
    env_class: type[gym.Env],
) -> Callable[[Callable[[Any], Kernel]], Callable[[Any], Kernel]]:
    """Decorator: declare a function as the maker of kernels for instances of ``env_class``.

    The function takes the (unwrapped) environment and reads from it what the kernel depends on.
    """

    def register(builder: Callable[[Any], Kernel]) -> Callable[[Any], Kernel]:
        _BUILDERS[env_class] = builder
        return builder

    return register


def kernel_of(env: gym.Env) -> Kernel:
    """The kernel of an environment, as it was built.

    Raises:
        LookupError: if there is none, or it does not serve this instance; says why.
    """
    builder = _BUILDERS.get(type(env.unwrapped))
    if builder is None:
        raise LookupError(f"no kernel is registered for {type(env.unwrapped).__name__}")
    return builder(env.unwrapped)
