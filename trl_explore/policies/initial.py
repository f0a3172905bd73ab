"""Initial weights; each trial draws from its own stream, independent of the other trials."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from trl_explore.checks import check_integer, check_number
from trl_explore.numerics.streams import Stream, generator

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
    network: int = 0,
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
        network: the index of the network within the trial, such as 0 for a policy and 1 for a
            critic; different networks use different random numbers.

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
        draws = generator(seed, Stream.WEIGHTS, first_trial + trial, network)
        for weight, layer in zip(weights, layers, strict=True):
            weight[trial] = INITS[init](draws, *layer)
    weights[-1] *= np.float32(output_gain)
    return [torch.from_numpy(weight) for weight in weights]


def glorot_uniform(
    trials: int, n_out: int, n_in: int, *, seed: int = 0, first_trial: int = 0
) -> Tensor:
    """Weights W ~ U(−b, b), b = √(6 / (n_in + n_out)); each trial draws from its own stream.

    The bound is that of one trial's layer (Glorot & Bengio 2010, eq. 16; the initialiser of the
    thesis's ``slim.fully_connected``).

    Returns:
        [trials, n_out, n_in] float32.
    """
    (weight,) = initial_weights([n_in, n_out], trials, seed=seed, first_trial=first_trial)
    return weight
