"""Objects from their configuration; an error in it is one line with the name of its group."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from functools import partial
from typing import Any, cast

from hydra._internal.utils import _locate
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from trl_explore.config.checking import describe
from trl_explore.config.files import ConfigError

KEPT = 64
"""Most constructors that are kept."""
_kept: dict[str, partial[Any]] = {}
"""The constructors of configurations that hold no other, by their text: Hydra makes them slowly."""


def constructor_of(config: Mapping[str, Any] | DictConfig, group: str) -> Callable[..., Any]:
    """The constructor that a group's configuration describes."""

    def construct(*args: Any, **kwargs: Any) -> Any:
        return calling(group, lambda: _constructor(config[group])(*args, **kwargs))

    return construct


def _constructor(node: dict[str, Any] | DictConfig) -> Callable[..., Any]:
    """``node`` with its own arguments; every agent gets objects of its own in them."""
    plain = node if isinstance(node, dict) else OmegaConf.to_container(node, resolve=True)
    plain = cast(dict[str, Any], plain)
    nested = "_target_" in str(list(plain.values()))
    if nested or not isinstance(plain.get("_target_"), str):
        return instantiate(node, _convert_="all", _partial_=True)
    text, target = repr(plain), _locate(plain["_target_"])  # a notebook may define it again
    if text not in _kept:
        if len(_kept) >= KEPT:
            _kept.clear()
        _kept[text] = instantiate(plain, _convert_="all", _partial_=True)
    made = _kept[text]
    return partial(target, *deepcopy(made.args), **deepcopy(made.keywords))


def calling(group: str | None, call: Callable[[], Any]) -> Any:
    """Call, and convert an error in the arguments to one line with the name of the group."""
    try:
        return call()
    except ConfigError:
        raise
    except MemoryError as error:
        line, cause = "not enough memory; reduce trials", error
    except (InstantiationException, ImportError, ValueError, TypeError, OverflowError) as error:
        within = error.__cause__ if isinstance(error, InstantiationException) else None
        line, cause = describe(within or error), error
    raise ConfigError(f"{group}: {line}" if group else line) from cause
