"""The density of a Gaussian policy."""

from __future__ import annotations

import math
from functools import reduce
from operator import add

from torch import Tensor

from trl_explore.numerics.threads import check_frames

LOG_SQRT_2PI = 0.5 * math.log(2 * math.pi)


def gaussian_log_prob(action: Tensor, loc: Tensor, scale: Tensor) -> Tensor:
    """Log N(a; loc, diag(scale²)) = −Σ_j [½ ((a_j − loc_j) / scale_j)² + log scale_j + ½ log 2π].

    The sum over j runs in their order, frame by frame. Made of torch's elementwise operations, it
    has every derivative that they have.

    Args:
        action: a [*batch, n_dims].
        loc: [*batch, n_dims].
        scale: [*batch, n_dims], > 0.

    Returns:
        [*batch], the logarithm of a density (nats).

    Raises:
        ValueError: if the shapes do not fit each other.

    Example:
        >>> import torch
        >>> zero, one = torch.zeros(2), torch.ones(2)
        >>> gaussian_log_prob(zero, zero, one).exp() * 2 * math.pi
        tensor(1.0000)
    """
    check_frames(loc.shape, action=action, scale=scale)
    terms = 0.5 * ((action - loc) / scale) ** 2 + scale.log() + LOG_SQRT_2PI
    return -reduce(add, terms.unbind(-1))


def gaussian_entropy(scale: Tensor) -> Tensor:
    """Σ_j [½ + ½ log 2π + log scale_j], the differential entropy of N(loc, diag(scale²)).

    Args:
        scale: [*batch, n_dims], > 0.

    Returns:
        [*batch] (nats).

    Example:
        >>> import torch
        >>> gaussian_entropy(torch.tensor([1 / math.sqrt(math.tau * math.e)]))
        tensor(0.)
    """
    return reduce(add, (0.5 + LOG_SQRT_2PI + scale.log()).unbind(-1))
