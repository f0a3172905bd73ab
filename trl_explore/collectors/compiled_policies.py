"""Policies in machine code for the episode loop: the same arithmetic as their torch modules."""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple, cast

import numpy as np
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from trl_explore.numerics.compiled.arrays import borrow
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.layers import WIDE, accumulate, relu32, tanh32
from trl_explore.policies import (
    GaussianLinearPolicy,
    GaussianMLPPolicy,
    LaneGaussian,
    LaneLinear,
    LaneMLP,
    LinearPolicy,
    MLPPolicy,
    TabularPolicy,
)
from trl_explore.policies.layers import has_hooks

CACHE_BYTES = 1 << 15
"""The weights of a group of episodes should stay in the processor's L1 cache."""
LOCAL = 64
"""A linear policy of at most this many weights is kept in the SIMD lanes."""


class Network(NamedTuple):
    """Everything that the machine code of a policy depends on.

    Attributes:
        kind: "linear", "table" or "mlp".
        sizes: the numbers of inputs, hidden units and outputs.
        activation: the activation of the hidden units.
        bias: whether layers have biases.
    """

    kind: str
    sizes: tuple[int, ...]
    activation: str = ""
    bias: bool = False

    @property
    def layers(self) -> list[tuple[int, int]]:
        """The (inputs, outputs) of every layer that is copied for each episode."""
        return list(pairwise(self.sizes)) if self.kind == "mlp" else []

    @property
    def local(self) -> int:
        """The number of weights kept in each SIMD lane: those of a small linear policy."""
        n_in, n_out = self.sizes[0], self.sizes[-1]
        return n_in * n_out if self.kind == "linear" and n_in * n_out <= LOCAL else 0

    def group(self) -> int:
        """The number of episodes whose weights fit into the cache."""
        own = sum(4 * n_out * (n_in + self.bias) for n_in, n_out in self.layers)
        return max(1, CACHE_BYTES // max(1, own))

    def memory(self, n: int) -> tuple[Any, ...]:
        """Memory for the weights of n episodes, by layer, and for the hidden units of one."""
        own = tuple(_room(n, *layer, self.bias) for layer in self.layers)
        return own, np.empty((2, max(self.sizes)), dtype=np.float32)


def _room(n: int, n_in: int, n_out: int, bias: bool) -> Any:
    columns = n_in + bias, n_out
    return np.empty((n, *(columns if n_out >= WIDE else columns[::-1])), dtype=np.float32)


def network_of(
    policy: TensorDictModuleBase, *, one_hot: bool = False
) -> tuple[Network, list[nn.Parameter]] | None:
    """The network of a policy, and its parameters; None if the loop does not support it.

    Args:
        policy: the policy.
        one_hot: whether observations are one-hot, so that W x is a column of W.
    """
    module = cast(Any, getattr(policy, "module", None))
    if has_hooks(policy):
        return None
    if type(policy) in (LinearPolicy, TabularPolicy) and type(module) is LaneLinear:
        kind = "table" if one_hot else "linear"
        weight = cast(nn.Parameter, module.weight)
        n_out, n_in = weight.shape[1:]
        return Network(kind, (n_in, n_out)), [weight]
    if type(policy) is MLPPolicy and type(module) is LaneMLP:
        return _mlp_of(module)
    return None


def gaussian_of(policy: TensorDictModuleBase) -> tuple[Network, list[nn.Parameter]] | None:
    """The network of a Gaussian policy's mean, and its parameters; None if not supported.

    A scale that depends on the observation is not supported.
    """
    module = cast(Any, getattr(policy, "module", None))
    known = type(policy) in (GaussianLinearPolicy, GaussianMLPPolicy)
    if not known or type(module) is not LaneGaussian or has_hooks(policy):
        return None
    if module.log_scale is None or type(module.network) is not LaneMLP:
        return None
    return _mlp_of(module.network)


def _mlp_of(module: LaneMLP) -> tuple[Network, list[nn.Parameter]]:
    """The network and parameters of a multilayer perceptron."""
    layers = [cast(LaneLinear, layer) for layer in module.layers]
    bias = layers[0].bias is not None
    parameters = [layer.weight for layer in layers]
    parameters += [cast(nn.Parameter, layer.bias) for layer in layers] if bias else []
    sizes = (layers[0].weight.shape[2], *(layer.weight.shape[1] for layer in layers))
    return Network("mlp", sizes, module.activation, bias), parameters


def arrays(network: Network, parameters: Sequence[Tensor]) -> Any:
    """The parameters in the form that the compiled functions take."""
    values = [np.ascontiguousarray(parameter.numpy(force=True)) for parameter in parameters]
    if network.kind != "mlp":
        return values[0]
    depth = len(network.layers)
    return tuple(values[:depth]), tuple(values[depth:])


def compile_network(network: Network) -> tuple[Any, Any]:
    """The functions of a policy, to be compiled into the loop.

        load(parameters, row, local, own, slot)   is called before an episode of trial ``row``
        logits(parameters, row, local, own, slot, hidden, x, out)   maps observation x to ``out``

    with ``parameters`` from ``arrays``, ``local`` [network.local] the weights kept in the SIMD
    lane, ``own`` and ``hidden`` from ``Network.memory``, and ``slot`` the episode's weight slot.
    """
    if network.kind == "mlp":
        return _mlp(network)
    n_in, n_out = network.sizes
    if network.local:
        return _local(n_in, n_out)
    return _nothing, (_table if network.kind == "table" else _linear)(n_in, n_out)


@kernel_function
def _nothing(parameters, row, local, own, slot):
    """Nothing to load: the policy reads the parameters directly."""


def _local(n_features: int, n_actions: int) -> tuple[Any, Any]:
    @kernel_function
    def load(parameters, row, local, own, slot):
        weight = borrow(parameters)
        for a in range(n_actions):
            for k in range(n_features):
                local[a * n_features + k] = weight[row, a, k]

    @kernel_function
    def logits(parameters, row, local, own, slot, hidden, x, out):
        for a in range(n_actions):
            logit = local[a * n_features] * x[0]
            for k in range(1, n_features):
                logit += local[a * n_features + k] * x[k]
            out[a] = logit

    return load, logits


def _linear(n_features: int, n_actions: int) -> Any:
    @kernel_function
    def logits(parameters, row, local, own, slot, hidden, x, out):
        weight = borrow(parameters)
        for a in range(n_actions):
            logit = weight[row, a, 0] * x[0]
            for k in range(1, n_features):
                logit += weight[row, a, k] * x[k]
            out[a] = logit

    return logits


def _table(n_features: int, n_actions: int) -> Any:
    @kernel_function
    def logits(parameters, row, local, own, slot, hidden, x, out):
        weight = borrow(parameters)
        state = 0
        for k in range(n_features):
            state += k * (x[k] != 0)
        for a in range(n_actions):
            out[a] = weight[row, a, state]

    return logits


def _mlp(network: Network) -> tuple[Any, Any]:
    phi = tanh32 if network.activation == "tanh" else relu32
    last = len(network.layers) - 1
    load, logits = _nothing, _nowhere
    for i, (n_in, n_out) in enumerate(network.layers):
        load = _load(load, i, n_in, n_out, network.bias)
        layer = _layer(i, n_in, n_out, network.bias)
        logits = _chain(logits, layer, i, n_out, phi, i == last)
    return load, logits


@kernel_function
def _nowhere(parameters, row, local, own, slot, hidden, x, out):
    """Nothing precedes the first layer."""


def _load(before: Any, i: int, n_in: int, n_out: int, bias: bool) -> Any:
    """Copy layer i after the layers ``before``; transposed if outputs are computed as vectors."""
    wide = n_out >= WIDE

    @kernel_function
    def load(parameters, row, local, own, slot):
        before(parameters, row, local, own, slot)
        weight, room = borrow(parameters[0][i]), borrow(own[i])
        for a in range(n_out):
            for k in range(n_in):
                if wide:
                    room[slot, k, a] = weight[row, a, k]
                else:
                    room[slot, a, k] = weight[row, a, k]
        if bias:
            start = borrow(parameters[1][i])
            for a in range(n_out):
                if wide:
                    room[slot, n_in, a] = start[row, a]
                else:
                    room[slot, a, n_in] = start[row, a]

    return load


def _layer(i: int, n_in: int, n_out: int, bias: bool) -> Any:
    """The affine map of layer i (``numerics.layers.lane_linear``)."""

    @kernel_function
    def wide(own, slot, x, out):
        columns = borrow(own[i])[slot]
        accumulate(columns, x, out, n_in, n_out)
        if bias:
            for a in range(n_out):
                out[a] += columns[n_in, a]

    @kernel_function
    def narrow(own, slot, x, out):
        rows = borrow(own[i])[slot]
        for a in range(n_out):
            total = rows[a, 0] * x[0]
            for k in range(1, n_in):
                total += rows[a, k] * x[k]
            out[a] = total + rows[a, n_in] if bias else total

    return wide if n_out >= WIDE else narrow


def _chain(before: Any, layer: Any, i: int, n_out: int, phi: Any, is_last: bool) -> Any:
    """The layers ``before``, then layer i with its activation."""
    source, target = (i + 1) % 2, i % 2
    take, give = _input if i == 0 else _hidden, _output if is_last else _hidden

    @kernel_function
    def logits(parameters, row, local, own, slot, hidden, x, out):
        before(parameters, row, local, own, slot, hidden, x, out)
        y = give(out, hidden, target)
        layer(own, slot, take(x, hidden, source), y)
        if not is_last:
            for a in range(n_out):
                y[a] = phi(y[a])

    return logits


@kernel_function
def _input(x, hidden, i):
    return x


@kernel_function
def _output(out, hidden, i):
    return out


@kernel_function
def _hidden(array, hidden, i):
    return borrow(hidden)[i]
