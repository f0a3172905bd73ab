"""Build and check one gymnasium environment; any error in its arguments becomes one line."""

from __future__ import annotations

import ast
import inspect
import textwrap
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from numbers import Real
from typing import Any

import gymnasium as gym

from trl_explore.checks import check_integer, check_number, first_line

TORCHRL = "torchrl:"
"""Prefix of an id that names a class of TorchRL environments."""
EXTRAS = {"gymnasium.envs.box2d": "box2d"}
"""Module of an environment -> the extra of this package that installs its dependencies."""


def make_gym(
    id: str,
    max_steps: int | None = None,
    kwargs: Mapping[str, Any] | None = None,
    attributes: Mapping[str, Any] | None = None,
    wrappers: Sequence[Callable[[gym.Env], gym.Env]] = (),
) -> gym.Env:
    """One gymnasium environment.

    Args:
        id: gymnasium id; ``torchrl:module.Class`` is a TorchRL environment (``envs.from_torchrl``).
        max_steps: time limit of an episode in steps; None means gymnasium's registered limit.
        kwargs: arguments of the environment's constructor.
        attributes: numbers, flags and strings of the environment to replace after construction, for
            constants that its constructor does not take.
        wrappers: what to wrap the environment in, from the inside to the outside.

    Raises:
        ValueError: if the id is unknown, a package is not installed, an argument is rejected, an
            attribute does not exist or has no effect, or a wrapper fails.

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
    for name in attributes or {}:
        _check_effect(env.unwrapped, id, str(name), attributes or {})
    for wrapper in wrappers:
        env = _wrap(id, env, wrapper)
    return env


def _wrap(id: str, env: gym.Env, wrapper: Callable[[gym.Env], gym.Env]) -> gym.Env:
    """Wrap an environment; any error of the wrapper becomes one line."""
    named = getattr(wrapper, "func", wrapper)
    name = getattr(named, "__name__", type(named).__name__)
    if isinstance(wrapper, partial):  # YAML has no tuples, and some wrappers take nothing else
        tuples = {k: tuple(v) if isinstance(v, list) else v for k, v in wrapper.keywords.items()}
        wrapper = partial(wrapper.func, *wrapper.args, **tuples)
    try:
        wrapped = wrapper(env)
    except Exception as error:
        raise ValueError(
            f"the wrapper {name} rejects environment {id!r} or its arguments: "
            f"{type(error).__name__}: {_whole(error)}"
        ) from error
    if not isinstance(wrapped, gym.Env):
        raise ValueError(
            f"the wrapper {name} makes a {type(wrapped).__name__}, not a gymnasium.Env"
        )
    return wrapped


def _construct(id: str, max_steps: int | None, kwargs: dict[str, Any]) -> gym.Env:
    """Construct an environment; any error of its constructor becomes one line."""
    if str(id).startswith(TORCHRL):
        from trl_explore.envs.from_torchrl import TorchRLEnv

        env = TorchRLEnv(id.removeprefix(TORCHRL), **kwargs)
        return env if max_steps is None else gym.wrappers.TimeLimit(env, max_steps)
    with _one_line(id, "rejects its arguments"), warnings.catch_warnings(record=True) as caught:
        # If this warning of Box2D's bindings is an error, they crash the interpreter.
        warnings.filterwarnings("ignore", "builtin type [Ss]wig", DeprecationWarning)
        env = gym.make(id, max_episode_steps=max_steps, disable_env_checker=True, **kwargs)
    for warning in caught:
        warnings.warn(warning.message, warning.category, stacklevel=2)
    return env


@contextmanager
def _one_line(id: str, what: str) -> Iterator[None]:
    """Turn the errors of an environment's code, which can raise anything, into one line each."""
    try:
        yield
    except gym.error.DependencyNotInstalled as error:
        raise ValueError(
            f"environment {id!r} needs a missing package: {_remedy(id, error)}"
        ) from error
    except ModuleNotFoundError as error:
        # Either the module in the id is missing, or a package that the environment imports.
        problem, module = f"environment {id!r} needs a missing package", id.rpartition(":")[0]
        if error.name and f"{module}.".startswith(f"{error.name}."):
            problem = f"unknown environment id {id!r}"
        raise ValueError(f"{problem}: {first_line(error)}") from error
    except gym.error.Error as error:
        raise ValueError(f"unknown environment id {id!r}: {first_line(error)}") from error
    except (Exception, SystemExit) as error:
        raise ValueError(
            f"environment {id!r} {what}: {type(error).__name__}: {_whole(error)}"
        ) from error


def _whole(error: BaseException) -> str:
    """The message of somebody else's code, which may have several lines, as one line."""
    return " ".join(str(error).split())[:1000]


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


def _check_effect(env: gym.Env, id: str, name: str, attributes: Mapping[str, Any]) -> None:
    """Reject an attribute from which the constructor has computed numbers that stay as they are.

    Raises:
        ValueError: if such a number is not among the attributes too.
    """
    derived = [
        other
        for other in _derived(type(env), name)
        if isinstance(getattr(env, other, None), Real) and other not in attributes
    ]
    if derived:
        raise ValueError(
            f"environment {id!r} has computed {' and '.join(derived)} from {name} when it was "
            f"built; set {'it' if len(derived) == 1 else 'them'} in env.attributes too"
        )


def _derived(env_class: type, name: str) -> list[str]:
    """The attributes that a constructor computes from another: ``self.a = ... self.name ...``."""
    try:
        source = textwrap.dedent(inspect.getsource(env_class.__init__))
    except (OSError, TypeError):  # compiled, or written in a shell
        return []
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Assign) and name in _own_names(node.value):
            found += [n for target in node.targets for n in _own_names(target) if n != name]
    return sorted(set(found))


def _own_names(node: ast.AST) -> list[str]:
    """The names x of every ``self.x`` in a piece of code."""
    return [
        part.attr
        for part in ast.walk(node)
        if isinstance(part, ast.Attribute)
        and isinstance(part.value, ast.Name)
        and part.value.id == "self"
    ]


def time_limit(id: str, env: gym.Env, max_steps: int | None) -> int:
    """The most steps of an episode.

    Raises:
        ValueError: if neither ``max_steps`` nor the registration says so.
    """
    limit = env.spec.max_episode_steps if env.spec is not None else max_steps
    if limit is None:
        raise ValueError(f"environment {id!r} has no registered time limit; set env.max_steps")
    return limit


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
    if id.startswith(TORCHRL):
        return None
    with _one_line(id, "cannot be imported"):
        module, _, name = id.rpartition(":")
        if module:
            import_module(module)
        threshold = gym.spec(name).reward_threshold
    return None if threshold is None else float(threshold)
