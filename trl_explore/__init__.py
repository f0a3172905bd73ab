"""What does the exploration strategy do to the learning of a policy-gradient agent?

Most programs need only the names below; each is imported on first use. Everything else is in the
subpackages: ``strategies``, ``policies``, ``objectives``, ``envs``, ``collectors``,
``training``, ``jobs``, ``statistics``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trl_explore.collectors import auto_collector
    from trl_explore.config.composing import train
    from trl_explore.envs import make_env
    from trl_explore.jobs.reading import read_frame
    from trl_explore.objectives import ReinforceLoss
    from trl_explore.policies import LinearPolicy
    from trl_explore.strategies import (
        Argmax,
        DecayingEpsilonGreedy,
        EpsilonGreedy,
        Random,
        Softmax,
    )
    from trl_explore.training.trainer import Trainer

__version__ = "0.1.0"

__all__ = [
    "Argmax",
    "DecayingEpsilonGreedy",
    "EpsilonGreedy",
    "LinearPolicy",
    "Random",
    "ReinforceLoss",
    "Softmax",
    "Trainer",
    "auto_collector",
    "make_env",
    "read_frame",
    "train",
]

_PLACES = {
    "LinearPolicy": "policies",
    "ReinforceLoss": "objectives",
    "Trainer": "training.trainer",
    "auto_collector": "collectors",
    "make_env": "envs",
    "read_frame": "jobs.reading",
    "train": "config.composing",
}
"""The module of each name that is not a strategy."""


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PLACES.get(name, 'strategies')}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
