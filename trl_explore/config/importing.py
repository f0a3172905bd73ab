"""Import TorchRL without torch's compiler, which no job needs: that saves a second."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import Any

PLACE, NAME = "torch", "_dynamo"
COMPILER = f"{PLACE}.{NAME}"
MODULES = ("torchrl.record", "trl_explore.training.shards")
"""These import all that a job needs."""


def import_torchrl() -> None:
    """Import TorchRL and this program's own modules.

    While they are imported, some of their functions get decorators for ``torch.compile``, and for
    these alone torch would import its compiler. They get none here. ``torch.compile`` works later,
    and traces these functions like any other.
    """
    import torch

    if COMPILER in sys.modules:
        return
    sys.modules[COMPILER] = later = _Later(COMPILER)
    setattr(torch, NAME, later)
    try:
        for name in MODULES:
            import_module(name)
    finally:
        later.leave()


class _Later(ModuleType):
    """Stands in for the compiler; imports it as soon as more than a decorator is needed."""

    def leave(self) -> None:
        """Let the next import of the compiler find the real one."""
        if sys.modules.get(COMPILER) is self:
            del sys.modules[COMPILER]
            delattr(sys.modules[PLACE], NAME)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") and name != "__path__":
            raise AttributeError(name)
        self.leave()
        return getattr(import_module(COMPILER), name)

    @staticmethod
    def allow_in_graph(function: Any) -> Any:
        return function

    assume_constant_result = allow_in_graph

    @staticmethod
    def disable(
        function: Any = None, recursive: bool = True, *, reason: str | None = None
    ) -> Callable[..., Any]:
        return function or (lambda decorated: decorated)
