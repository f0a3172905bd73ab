"""The trainer's interface to an optimiser, and torch's optimisers over independent trials."""

# numba rewrites signatures:
# pyright: reportCallIssue=false

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol, cast

import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.optim import Optimizer

from trl_explore.checks import check_number
from trl_explore.numerics.compiled.cache import compiled

Parameters = Iterable[nn.Parameter] | Iterable[Mapping[str, Any]]
"""Parameters, or parameter groups as in torch: {"params": [...], "lr": 1.0}."""


class TrialOptimizer(Protocol):
    """The interface that the trainer uses: an optimiser over parameters [trials, ...]."""

    parameters: list[nn.Parameter]

    def zero_grad(self) -> None:
        """Discard the gradients."""
        ...

    def step(self, active: Tensor | None = None) -> None:
        """Update the trials in ``active`` [trials] bool; None means all."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """All that the next steps depend on, except parameters and gradients."""
        ...

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore a ``state_dict``."""
        ...


def grouped(parameters: Parameters, lr: float) -> list[dict[str, Any]]:
    """The parameter groups, each with a learning rate: its own, or ``lr``.

    Raises:
        ValueError: if a learning rate is not a positive number.
    """
    entries = list(parameters)
    if not entries or not isinstance(entries[0], Mapping):
        entries = [{"params": entries}]
    groups = [dict(group) for group in cast(list[Mapping[str, Any]], entries)]
    for group in groups:
        params = group["params"]
        group["params"] = [params] if isinstance(params, nn.Parameter) else list(params)
        group["lr"] = check_number("lr", group.get("lr", lr), 0, low_open=True)
    return groups


class Views:
    """Arrays [rows, elements] that share memory with tensors; renewed if that memory has moved.

    Args:
        tensors: on the CPU and contiguous; read at every call, so that they can be replaced.

    Example:
        >>> import torch
        >>> weight = torch.nn.Parameter(torch.zeros(2, 1, 3))
        >>> views = Views([weight])
        >>> views()[0][1, 2] = 5
        >>> weight.detach().flatten().tolist()
        [0.0, 0.0, 0.0, 0.0, 0.0, 5.0]
    """

    def __init__(self, tensors: Sequence[Tensor]) -> None:
        self.tensors = tensors
        self._places: list[tuple[int, Any]] = []
        self._arrays: list[NDArray[Any]] = []

    def __call__(self) -> list[NDArray[Any]]:
        """The arrays, in the order of the tensors."""
        # A view keeps its memory alive, so no other tensor can have the same address.
        places = [(t.data_ptr(), t.shape) for t in self.tensors]
        if places != self._places:
            self._arrays = [t.detach().view(len(t), -1).numpy() for t in self.tensors]
            self._places = places
        return self._arrays


def all_finite(rows: NDArray[Any]) -> bool:
    """Whether every number is finite.

    Args:
        rows: [*], contiguous.
    """
    return _all_finite(rows.reshape(-1))


@compiled()
def _all_finite(x):
    """Whether all numbers are finite; twin: ``numpy.isfinite(x).all()``."""
    broken = 0
    for i in range(len(x)):  # no early exit, so that the loop is vectorised
        broken += (x[i] - x[i]) != 0
    return broken == 0


class LaneOptimizer:
    """An elementwise torch optimiser over parameters [trials, ...] that updates active trials only.

    A zero gradient does not stop a trial: momentum would still change its weights. So the rows of
    stopped trials are restored, in the parameters and in the optimiser's state.

    Args:
        factory: parameters -> optimiser, such as ``functools.partial(torch.optim.SGD, lr=0.05)``.
        parameters: each with the trials as dimension 0; or parameter groups, as in torch.
    """

    def __init__(
        self,
        factory: Callable[[Any], Optimizer],
        parameters: Parameters,
    ) -> None:
        self.optimizer = factory(list(parameters))
        self.parameters = [p for group in self.optimizer.param_groups for p in group["params"]]

    def zero_grad(self) -> None:
        """Discard the gradients."""
        self.optimizer.zero_grad(set_to_none=True)

    @torch.no_grad()
    def step(self, active: Tensor | None = None) -> None:
        """Update the trials in ``active`` [trials] bool; None means all."""
        if active is None or bool(active.all()):
            self.optimizer.step()
            return
        stopped = (~active).nonzero().squeeze(-1)
        kept = [(rows, rows.index_select(0, stopped)) for rows in self.rows()]
        self.optimizer.step()
        for rows, before in kept:
            rows.index_copy_(0, stopped, before)

    def rows(self) -> list[Tensor]:
        """Every tensor with one row per trial: the parameters and their optimiser state."""
        found: list[Tensor] = []
        for parameter in self.parameters:
            state = self.optimizer.state.get(parameter, {}).values()
            same = [v for v in state if isinstance(v, Tensor) and v.shape == parameter.shape]
            found += [parameter.data, *same]
        return found

    def state_dict(self) -> dict[str, Any]:
        """The state of every parameter, by its index."""
        return {
            str(i): {
                name: value.clone() if isinstance(value, Tensor) else value
                for name, value in self.optimizer.state.get(parameter, {}).items()
                if value is not None
            }
            for i, parameter in enumerate(self.parameters)
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore a ``state_dict``."""
        for i, parameter in enumerate(self.parameters):
            self.optimizer.state[parameter] = {
                name: value.clone() if isinstance(value, Tensor) else value
                for name, value in state[str(i)].items()
            }


ELEMENTWISE = (
    *("ASGD", "Adadelta", "Adagrad", "Adam", "AdamW", "Adamax", "NAdam", "RAdam", "RMSprop"),
    *("Rprop", "SGD"),
)
"""The optimisers of ``torch.optim`` that update every element of a parameter independently."""
COUPLING = {
    "Adafactor": "its second moments are means over rows and columns of a parameter",
    "LBFGS": "its step depends on all elements and on the total loss",
    "Muon": "it orthogonalises a parameter as one matrix",
    "SparseAdam": "it takes sparse gradients only; use Adam for these dense ones",
}
"""The optimisers that would couple the trials or do not apply, with the reason."""
HELD = ("params", "lr", "foreach", "fused", "capturable", "differentiable")
"""Arguments that are not options: set elsewhere, or fixed so that all elements round alike."""


def torch_optimizer(
    parameters: Parameters,
    *,
    name: str,
    lr: float = 0.05,
    options: Mapping[str, Any] | None = None,
) -> LaneOptimizer:
    """An elementwise optimiser of ``torch.optim`` over independent trials, by name.

    Args:
        parameters: the parameters, or parameter groups.
        name: one of ``ELEMENTWISE``.
        lr: the learning rate, > 0.
        options: further arguments of the torch class, such as ``{"momentum": 0.9}``.

    Raises:
        ValueError: if the optimiser is unknown or would couple the trials (see ``COUPLING``), or
            an option is not one of its arguments or is out of range.

    Example:
        >>> weight = torch.nn.Parameter(torch.zeros(2, 1))
        >>> sgd = torch_optimizer([weight], name="SGD", lr=0.5, options={"momentum": 0.9})
        >>> weight.grad = torch.ones(2, 1)
        >>> sgd.step(torch.tensor([True, False]))
        >>> weight.detach().tolist()
        [[-0.5], [0.0]]
    """
    if isinstance(name, str) and name in COUPLING:
        raise ValueError(f"{name} cannot train independent trials: {COUPLING[name]}")
    if name not in ELEMENTWISE:
        raise ValueError(f"name must be one of {', '.join(ELEMENTWISE)}, got {name!r}")
    if not isinstance(options, Mapping | None):
        raise ValueError(f"options must map names to values, {{momentum: 0.9}}, got {options!r}")
    kind = getattr(torch.optim, name)
    arguments = [*inspect.signature(kind).parameters]
    allowed = [argument for argument in arguments if argument not in HELD]
    for option in options or {}:
        if option not in allowed:
            raise ValueError(f"{name} has only the options {', '.join(allowed)}, got {option!r}")
    check_number("lr", lr, 0, low_open=True)
    held = {argument: False for argument in ("foreach", "fused") if argument in arguments}
    factory = partial(kind, lr=lr, **held, **(options or {}))
    try:
        return LaneOptimizer(lambda given: factory(grouped(given, lr)), parameters)
    except (TypeError, IndexError) as error:  # torch compares and unpacks them unchecked
        raise ValueError(f"{name} rejects its options {dict(options or {})}: {error}") from None
