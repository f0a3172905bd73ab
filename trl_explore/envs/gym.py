"""Build and check one gymnasium environment; any error in its arguments becomes one line."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from importlib import import_module
from numbers import Real
from typing import Any

import gymnasium as gym

from trl_explore.checks import check_integer, check_number, first_line

EXTRAS = {"gymnasium.envs.box2d": "box2d"}
"""Module of an environment -> the extra of this package that installs its dependencies."""


def make_gym(
    id: str,
    max_steps: int | None = None,
    kwargs: Mapping[str, Any] | None = None,
    attributes: Mapping[str, Any] | None = None,
) -> gym.Env:
    """One gymnasium environment.

    Args:
        id: gymnasium id.
        max_steps: time limit of an episode in steps; None means gymnasium's registered limit.
        kwargs: arguments of the environment's constructor.
        attributes: numbers, flags and strings of the environment to replace after construction, for
            constants that its constructor does not take. Values that the constructor has derived
            from them do not change.

    Raises:
        ValueError: if the id is unknown, a package is not installed, an argument is rejected, an
            attribute does not exist.

    Example:
        >>> env = make_gym("CartPole-v1", attributes={"theta_threshold_radians": 0.26})
        >>> env.unwrapped.theta_threshold_radians
        0.26
    """
    if max_steps is not None:
        check_integer("max_steps", max_steps, 1, 10**9)
    env = _construct(id, max_steps, dict(kwargs or {}))
    for name, value in (attributes or {}).items():
        _set_attribute(env.unwrapped, id, name, value)
    return env


def _construct(id: str, max_steps: int | None, kwargs: dict[str, Any]) -> gym.Env:
    """Construct an environment; any error of its constructor becomes one line."""
    try:
        with warnings.catch_warnings(record=True) as caught:
            # If this warning of Box2D's bindings is an error, they crash the interpreter.
            warnings.filterwarnings("ignore", "builtin type [Ss]wig", DeprecationWarning)
            env = gym.make(id, max_episode_steps=max_steps, disable_env_checker=True, **kwargs)
    except gym.error.DependencyNotInstalled as error:
        raise ValueError(
            f"environment {id!r} needs a missing package: {_remedy(id, error)}"
        ) from error
    except (gym.error.Error, ModuleNotFoundError) as error:
        raise ValueError(f"unknown environment id {id!r}: {first_line(error)}") from error
    except Exception as error:
        raise ValueError(
            f"environment {id!r} rejects its arguments: {type(error).__name__}: {first_line(error)}"
        ) from error
    for warning in caught:
        warnings.warn(warning.message, warning.category, stacklevel=2)
    return env


def _remedy(id: str, error: Exception) -> str:
    """How to install an environment's missing package."""
    entry = str(gym.spec(id).entry_point)
    for module, extra in EXTRAS.items():
        if entry.startswith(module):
            return f"pip install 'trl_explore[{extra}]'"
    return first_line(error)


def _set_attribute(env: gym.Env, id: str, name: str, value: Any) -> None:
    """Replace an attribute with a value of the same kind.

    Raises:
        ValueError: if the attribute does not exist, or the value is of another kind.
    """
    old = getattr(env, str(name), None)
    kinds = (bool, Real, str)
    kind = next((kind for kind in kinds if isinstance(old, kind)), None)
    if kind is None:
        raise ValueError(f"environment {id!r} has no number, flag or text named {str(name)!r}")
    if kind is Real:
        value = check_number(f"the attribute {name} of {id!r}", value)
        value = int(value) if isinstance(old, int) and value.is_integer() else value
    elif not isinstance(value, kind):
        raise ValueError(
            f"the attribute {name} of {id!r} must be {'true or false' if kind is bool else 'text'},"
            f" got {value!r}"
        )
    setattr(env, name, value)


def reward_threshold(id: str) -> float | None:
    """The mean score at which gymnasium considers an environment solved; None if not registered.

    Args:
        id: gymnasium id; ``module:id`` imports the module that registers it.

    Raises:
        ValueError: if the id is unknown, or importing its module fails.

    Example:
        >>> reward_threshold("Acrobot-v1")
        -100.0
    """
    try:
        module, _, name = id.rpartition(":")
        if module:
            import_module(module)
        threshold = gym.spec(name).reward_threshold
    except (gym.error.Error, ModuleNotFoundError) as error:
        raise ValueError(f"unknown environment id {id!r}: {first_line(error)}") from error
    except Exception as error:  # an import can raise anything
        raise ValueError(
            f"environment {id!r} cannot be imported: {type(error).__name__}: {first_line(error)}"
        ) from error
    return None if threshold is None else float(threshold)
