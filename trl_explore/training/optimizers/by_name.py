"""The optimisers of torch by name: those that leave the trials independent of each other."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from functools import partial
from typing import Any

import torch
from torch.optim import Adam

from trl_explore.checks import check_number
from trl_explore.training.optimizers.optimizer import LaneOptimizer, Parameters, grouped

ELEMENTWISE = (
    *("ASGD", "Adadelta", "Adagrad", "Adam", "AdamW", "Adamax", "NAdam", "RAdam", "RMSprop"),
    *("Rprop", "SGD"),
)
"""The optimisers of ``torch.optim`` that treat every element of a parameter by itself."""
COUPLING = {
    "Adafactor": "its second moments are means over rows and columns of a parameter",
    "LBFGS": "its step is a function of all elements, and of the loss as a whole",
    "Muon": "it orthogonalises a parameter as one matrix",
    "SparseAdam": "it takes sparse gradients only; Adam is the same for these dense ones",
}
"""Those that would couple the trials or do not serve, and why."""
HELD = ("params", "lr", "foreach", "fused", "capturable", "differentiable")
"""Arguments that are not options: set elsewhere, or held so that elements are treated alike."""


def adam(parameters: Parameters, *, lr: float = 0.05) -> Adam:
    """The Adam of torch in the form that treats every element alike, wherever it lies in memory.

    Args:
        parameters: the parameters, or groups of them.
        lr: the learning rate, > 0.

    Raises:
        ValueError: if a learning rate is not a positive number.
    """
    check_number("lr", lr, 0, low_open=True)
    return Adam(grouped(parameters, lr), lr=lr, foreach=False, fused=False)


def torch_adam(parameters: Parameters, *, lr: float = 0.05) -> LaneOptimizer:
    """``adam`` over lanes: the reference that ``LaneAdam`` is held against."""
    return LaneOptimizer(partial(adam, lr=lr), parameters)


def torch_optimizer(
    parameters: Parameters,
    *,
    name: str,
    lr: float = 0.05,
    options: Mapping[str, Any] | None = None,
) -> LaneOptimizer:
    """An elementwise optimiser of ``torch.optim`` over lanes, by its name.

    Args:
        parameters: the parameters, or groups of them.
        name: one of ``ELEMENTWISE``.
        lr: the learning rate, > 0.
        options: further arguments of the torch class, such as ``{"momentum": 0.9}``.

    Raises:
        ValueError: if the optimiser would couple the trials (``COUPLING`` says why) or is unknown,
            or an option is not one of its arguments or out of range.

    Example:
        >>> weight = torch.nn.Parameter(torch.zeros(2, 1))
        >>> sgd = torch_optimizer([weight], name="SGD", lr=0.5, options={"momentum": 0.9})
        >>> weight.grad = torch.ones(2, 1)
        >>> sgd.step(torch.tensor([True, False]))
        >>> weight.detach().tolist()
        [[-0.5], [0.0]]
    """
    if name in COUPLING:
        raise ValueError(f"{name} cannot train independent trials: {COUPLING[name]}")
    if name not in ELEMENTWISE:
        raise ValueError(f"name must be one of {', '.join(ELEMENTWISE)}, got {name!r}")
    kind = getattr(torch.optim, name)
    arguments = [*inspect.signature(kind).parameters]
    allowed = [argument for argument in arguments if argument not in HELD]
    for option in options or {}:
        if option not in allowed:
            raise ValueError(f"{name} has the options {', '.join(allowed)}, got {option!r}")
    check_number("lr", lr, 0, low_open=True)
    held = {argument: False for argument in ("foreach", "fused") if argument in arguments}
    return LaneOptimizer(
        lambda given: kind(grouped(given, lr), lr=lr, **held, **(options or {})), parameters
    )
