"""What a compiled environment is, and the table of those that exist."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numba.extending import is_jitted

Function = Any
_NUMBER = (str, int, float, np.generic)


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
        mask: ``mask(parameters, state, mask)`` fills a bool array [n_actions], False where an
            action is not allowed; None: all always are.
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
                raise ValueError(f"{name} closes over values; hand them over as parameters")

    @property
    def digest(self) -> str:
        """A fingerprint of what the functions are compiled from: source files and constants.

        It decides which compiled code on disk may be used again.
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
