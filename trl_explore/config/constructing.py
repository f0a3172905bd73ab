"""Objects from their configuration; an error in it is one line with the name of its group."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any, cast

from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from trl_explore.config.checking import describe
from trl_explore.config.files import ConfigError

KEPT = 64
"""Most constructors that are kept."""
_kept: dict[str, Callable[..., Any]] = {}
"""Constructors whose configuration holds no other, by its text: Hydra is slow to make one."""


def constructor_of(config: DictConfig, group: str) -> Callable[..., Any]:
    """The constructor that a group's configuration describes."""

    def construct(*args: Any, **kwargs: Any) -> Any:
        return calling(group, lambda: _constructor(config[group])(*args, **kwargs))

    return construct


def _constructor(node: DictConfig) -> Callable[..., Any]:
    """``node`` with its own arguments; every agent gets objects of its own in them."""
    plain = OmegaConf.to_container(node, resolve=True)
    if "_target_" in str(list(cast(dict[str, Any], plain).values())):
        return instantiate(node, _convert_="all", _partial_=True)
    key = repr(plain)
    if key not in _kept:
        if len(_kept) >= KEPT:
            _kept.clear()
        _kept[key] = instantiate(plain, _convert_="all", _partial_=True)
    return deepcopy(_kept[key])


def calling(group: str | None, call: Callable[[], Any]) -> Any:
    """Call, and convert an error in the arguments to one line with the name of the group."""
    try:
        return call()
    except ConfigError:
        raise
    except MemoryError as error:
        line, cause = "not enough memory; reduce trials", error
    except (InstantiationException, ValueError, TypeError, OverflowError) as error:
        within = error.__cause__ if isinstance(error, InstantiationException) else None
        line, cause = describe(within or error), error
    raise ConfigError(f"{group}: {line}" if group else line) from cause
