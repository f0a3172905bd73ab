"""Mixture strategies in machine code, for the episode loop: from logits to μ, and to an action."""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import math

import numpy as np

from trl_explore.kernels.base import kernel_function

_TINY, _HUGE = np.float32(np.finfo(np.float32).tiny), np.float32(np.finfo(np.float32).max)


@kernel_function
def _softmax_of_two(probs, temperature):
    """Softmax of two logits in place, with one exponential."""
    one = np.float32(1)
    d = (probs[0] - probs[1]) / temperature
    e = np.float32(math.exp(-abs(d)))
    larger = one / (one + e)
    first = d > 0
    probs[0] = larger if first else e * larger
    probs[1] = e * larger if first else larger


@kernel_function
def mix(probs, work, mixture, column):
    """Turn logits into μ in place (``strategies.mixture_probs``)."""
    n = len(probs)
    greedy, soft = np.float32(mixture[0, column]), np.float32(mixture[1, column])
    uniform = np.float32(mixture[2, column])
    temperature = min(max(np.float32(mixture[3, column]), _TINY), _HUGE)
    if n == 2 and soft == 1:  # the common case
        _softmax_of_two(probs, temperature)
        return
    largest = probs[0]
    for k in range(1, n):
        largest = max(largest, probs[k])
    work[:] = 0
    if soft != 0:
        _add_softmax(probs, work, soft, largest, temperature)
    if greedy != 0:
        _add_greedy(probs, work, greedy, largest)
    if uniform != 0:
        _add_uniform(probs, work, uniform)
    for k in range(n):
        probs[k] = work[k]


@kernel_function
def _add_softmax(logits, work, weight, largest, temperature):
    total = np.float32(0)
    for k in range(len(logits)):
        work[k] = math.exp((logits[k] - largest) / temperature)
        total += work[k]
    for k in range(len(logits)):
        work[k] = weight * (work[k] / total)


@kernel_function
def _add_greedy(logits, work, weight, largest):
    ties = np.float32(0)
    for k in range(len(logits)):
        ties += np.float32(logits[k] == largest)
    for k in range(len(logits)):
        work[k] += weight * (np.float32(logits[k] == largest) / ties)


@kernel_function
def _add_uniform(logits, work, weight):
    legal = np.float32(0)
    for k in range(len(logits)):
        legal += np.float32(logits[k] != -np.inf)
    for k in range(len(logits)):
        work[k] += weight * (np.float32(logits[k] != -np.inf) / legal)


@kernel_function
def draw(probs, u):
    """The action that ``u`` selects (``strategies.inverse_cdf``)."""
    n = len(probs)
    total = 0.0
    for k in range(n):
        total += np.float64(probs[k])
    point = u * total
    if point >= total:
        point = np.nextafter(total, 0.0)
    below = 0.0
    chosen = 0
    for k in range(n - 1):
        below += np.float64(probs[k])
        chosen += below <= point
    return chosen
