"""Layers with one set of weights per trial, their initial weights, and the sizes in specs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypedDict, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torchrl.data import Bounded, Categorical, Unbounded
from torchrl.envs import Compose, EnvBase, RewardSum, StepCounter, TransformedEnv

from trl_explore.checks import check_flag, check_integer, check_number
from trl_explore.numerics.layers import activate, check_activation, lane_linear
from trl_explore.numerics.streams import Stream, generator

if TYPE_CHECKING:
    import gymnasium as gym


WIDEST = 1_000_000
"""The largest number of units per layer; more is treated as a mistake."""

Draw = Callable[[np.random.Generator, int, int], NDArray[np.float64]]


def _uniform(bound: Callable[[int, int], float]) -> Draw:
    return lambda draws, n_out, n_in: draws.uniform(
        -bound(n_out, n_in), bound(n_out, n_in), (n_out, n_in)
    )


def _normal(deviation: Callable[[int, int], float]) -> Draw:
    return lambda draws, n_out, n_in: deviation(n_out, n_in) * draws.standard_normal((n_out, n_in))


def _orthogonal(draws: np.random.Generator, n_out: int, n_in: int) -> NDArray[np.float64]:
    """Q of a normal matrix's QR decomposition, its signs those of R's diagonal (Haar measure)."""
    tall = draws.standard_normal((max(n_out, n_in), min(n_out, n_in)))
    q, r = np.linalg.qr(tall)
    q = q * np.where(np.diag(r) < 0, -1.0, 1.0)
    return q if n_out >= n_in else q.T


INITS: dict[str, Draw] = {
    "glorot_uniform": _uniform(lambda n_out, n_in: math.sqrt(6 / (n_in + n_out))),
    "glorot_normal": _normal(lambda n_out, n_in: math.sqrt(2 / (n_in + n_out))),
    "he_uniform": _uniform(lambda n_out, n_in: math.sqrt(6 / n_in)),
    "he_normal": _normal(lambda n_out, n_in: math.sqrt(2 / n_in)),
    "lecun_normal": _normal(lambda n_out, n_in: math.sqrt(1 / n_in)),
    "normal": _normal(lambda n_out, n_in: 1.0),
    "orthogonal": _orthogonal,
    "zeros": lambda draws, n_out, n_in: np.zeros((n_out, n_in)),
}
"""Name -> weights [n_out, n_in] of one layer of one trial."""


def initial_weights(
    sizes: Sequence[int],
    trials: int,
    init: str = "glorot_uniform",
    *,
    output_gain: float = 1.0,
    seed: int = 0,
    first_trial: int = 0,
) -> list[Tensor]:
    """The weights of a chain of layers; each trial draws from its own stream.

    ``init`` gives the weights of a layer with n_in inputs and n_out outputs:

        glorot_uniform   U(−b, b), b = √(6 / (n_in + n_out))   Glorot & Bengio 2010, eq. 16
        glorot_normal    N(0, 2 / (n_in + n_out))              Glorot & Bengio 2010, eq. 12
        he_uniform       U(−b, b), b = √(6 / n_in)             He et al. 2015, eq. 10
        he_normal        N(0, 2 / n_in)                        He et al. 2015, eq. 10
        lecun_normal     N(0, 1 / n_in)                        LeCun et al. 1998, eq. 16
        normal           N(0, 1)
        orthogonal       WᵀW = 1 or WWᵀ = 1, uniformly drawn   Saxe et al. 2014
        zeros            0

    Args:
        sizes: the number of inputs, the units of every hidden layer, and the number of outputs.
        trials: the number of trials.
        init: one of the names above.
        output_gain: factor of the last layer's weights, >= 0; if small, initial outputs are near 0.
        seed: seed of the job.
        first_trial: trial index of row 0.

    Returns:
        [trials, n_out, n_in] float32 for every layer.

    Raises:
        ValueError: if ``init`` is unknown, a size is out of range, or the gain is negative.

    Example:
        >>> [w.shape for w in initial_weights([4, 32, 2], trials=3)]
        [torch.Size([3, 32, 4]), torch.Size([3, 2, 32])]
    """
    if init not in INITS:
        raise ValueError(f"init must be one of {', '.join(INITS)}, got {init!r}")
    check_number("output_gain", output_gain, 0)
    for size in sizes:
        check_integer("the size of a layer", size, 1, WIDEST)
    layers = [(n_out, n_in) for n_in, n_out in pairwise(sizes)]
    weights = [np.empty((trials, *layer), dtype=np.float32) for layer in layers]
    for trial in range(trials):
        draws = generator(seed, Stream.WEIGHTS, first_trial + trial, 0)
        for weight, layer in zip(weights, layers, strict=True):
            weight[trial] = INITS[init](draws, *layer)
    weights[-1] *= np.float32(output_gain)
    return [torch.from_numpy(weight) for weight in weights]


def spec_env(env: EnvBase) -> EnvBase:
    """The environment to ask for the specs of observations and actions.

    ``StepCounter`` and ``RewardSum`` make all specs slow to compute, and do not change those unless
    they write to the same entries.
    """
    if not isinstance(env, TransformedEnv):
        return env
    transform: Any = env.transform
    kinds = {type(t) for t in (transform if isinstance(transform, Compose) else [transform])}
    return cast(EnvBase, env.base_env) if kinds <= {StepCounter, RewardSum} else env


def n_actions(env: EnvBase) -> int:
    """The number of actions of an environment with a Categorical action spec."""
    spec = spec_env(env).action_spec
    if not isinstance(spec, Categorical):
        raise ValueError(
            f"a softmax policy needs a Categorical action spec, got {type(spec).__name__}"
        )
    return spec.n


def n_dims(env: EnvBase) -> int:
    """The number of dimensions of a continuous action.

    Raises:
        ValueError: if the actions are not vectors of real numbers.
    """
    spec = spec_env(env).action_spec
    if not isinstance(spec, Bounded | Unbounded) or spec.domain != "continuous":
        raise ValueError(
            f"a Gaussian policy needs a Bounded or Unbounded action spec, got {type(spec).__name__}"
        )
    return spec.shape[-1]


def n_features(env: EnvBase) -> int:
    """The length of an observation."""
    return spec_env(env).observation_spec["observation"].shape[-1]


def layer_sizes(env: EnvBase, hidden: Sequence[int], n_out: int) -> list[int]:
    """The sizes of a network from the observations to ``n_out`` numbers, for ``LaneMLP``."""
    if isinstance(hidden, str) or not isinstance(hidden, Sequence):
        raise ValueError(f"hidden must be a list of sizes such as [32, 32], got {hidden!r}")
    return [n_features(env), *hidden, n_out]


def observation_space(env: EnvBase) -> gym.Space:
    """The observation space of an environment of ``make_env`` before flattening."""
    from trl_explore.envs import lane_env

    return lane_env(env).envs[0].observation_space


def is_one_hot(env: EnvBase) -> bool:
    """Whether the observations are one-hot states."""
    from gymnasium.spaces import Discrete

    from trl_explore.envs.make import own_transforms

    return isinstance(observation_space(env), Discrete) and not own_transforms(env)


def has_hooks(module: nn.Module) -> bool:
    """Whether the module or a submodule has hooks, so that a call does more than ``forward``."""
    kinds = ("_forward_hooks", "_forward_pre_hooks", "_backward_hooks", "_backward_pre_hooks")
    return any(getattr(part, kind) for part in module.modules() for kind in kinds)


class LaneLinear(nn.Module):
    """y = W[trial] x + b[trial]; ``weight`` is [trials, n_out, n_in], ``bias`` [trials, n_out].

    Args:
        weight: the initial weights.
        bias: the initial bias; None for b = 0.
    """

    def __init__(self, weight: Tensor, bias: Tensor | None = None) -> None:
        super().__init__()
        self.weight = nn.Parameter(weight)
        self.bias = None if bias is None else nn.Parameter(bias)

    def forward(self, observation: Tensor, trial: Tensor) -> Tensor:
        """[*batch, n_in], [*batch] -> [*batch, n_out]."""
        return lane_linear(observation, self.weight, trial, self.bias)


class NetworkOptions(TypedDict, total=False):
    """The arguments of ``LaneMLP`` that policies take too."""

    activation: str
    init: str
    seed: int
    first_trial: int
    bias: bool
    output_gain: float


class LaneMLP(nn.Module):
    """A multilayer perceptron per trial: y = W_L h_{L−1} + b_L, h_i = φ(W_i h_{i−1} + b_i).

    h_0 is the input; φ = tanh or relu; biases are initially 0. Each sum runs over the frames of one
    trial, in a fixed order, so a trial's outputs and gradients do not depend on the other trials,
    bit for bit.

    Args:
        sizes: the number of inputs, the units of every hidden layer (any number of layers), and
            the number of outputs.
        trials: the number of trials.
        activation: φ, "tanh" or "relu".
        init: the initial weights, a name from ``initial_weights``; "zeros" only without hidden
            layers, which would have no gradient.
        seed: seed of the job.
        first_trial: trial index of row 0.
        bias: whether there are biases.
        output_gain: factor of the last layer's initial weights.

    Raises:
        ValueError: if an argument is out of range or unknown.

    Example:
        >>> mlp = LaneMLP([4, 32, 32, 2], trials=3)
        >>> mlp(torch.ones(5, 4), torch.tensor([0, 0, 1, 1, 2])).shape
        torch.Size([5, 2])
    """

    def __init__(
        self,
        sizes: Sequence[int],
        trials: int,
        activation: str = "tanh",
        init: str = "glorot_uniform",
        seed: int = 0,
        first_trial: int = 0,
        *,
        bias: bool = True,
        output_gain: float = 1.0,
    ) -> None:
        super().__init__()
        self.activation = check_activation(activation)
        self.sizes = list(sizes)
        if init == "zeros" and len(sizes) > 2:
            raise ValueError("init 'zeros' gives hidden layers no gradient; choose another init")
        streams = {"seed": seed, "first_trial": first_trial}
        weights = initial_weights(sizes, trials, init, output_gain=output_gain, **streams)
        self.layers = nn.ModuleList(
            LaneLinear(weight, torch.zeros(weight.shape[:2]) if check_flag("bias", bias) else None)
            for weight in weights
        )

    def forward(self, observation: Tensor, trial: Tensor) -> Tensor:
        """[*batch, n_in], [*batch] -> [*batch, n_out]."""
        *hidden, last = cast(list[LaneLinear], list(self.layers))
        for layer in hidden:
            observation = activate(layer(observation, trial), self.activation)
        return last(observation, trial)
