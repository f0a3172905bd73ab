"""Mixture strategies in machine code for the episode loop: from logits to μ to an action.

For two actions nothing here branches on data, so that it becomes vector instructions: see ``loop``.
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from typing import Any

import numpy as np

from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.elementary import exp32

_TINY, _HUGE = np.float32(np.finfo(np.float32).tiny), np.float32(np.finfo(np.float32).max)
_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)


@kernel_function
def load_point(mixture, column, point):
    """Copy a trial's weights of argmax, softmax and uniform and temperature to ``point`` [4]."""
    for i in range(3):
        point[i] = mixture[i, column]
    point[3] = min(max(np.float32(mixture[3, column]), _TINY), _HUGE)


@kernel_function
def _mix_two(probs, work, point):
    """``mix`` for two actions, with one exponential."""
    greedy, soft, uniform, temperature = point[0], point[1], point[2], point[3]
    first, second = probs[0], probs[1]
    d = (first - second) / temperature
    e = exp32(-abs(d))
    larger = _ONE / (_ONE + e)
    smaller = e * larger
    soft1 = larger if d > 0 else smaller
    soft2 = smaller if d > 0 else larger
    greedy1 = _ONE if first > second else (_HALF if first == second else _ZERO)
    legal1, legal2 = np.float32(first != -np.inf), np.float32(second != -np.inf)
    legal = legal1 + legal2
    mu1, mu2 = (soft * soft1, soft * soft2) if soft != _ZERO else (_ZERO, _ZERO)
    probs[0] = (mu1 + greedy * greedy1) + uniform * (legal1 / legal)
    probs[1] = (mu2 + greedy * (_ONE - greedy1)) + uniform * (legal2 / legal)


def compile_mixing(n_actions: int) -> tuple[Any, Any, Any]:
    """The functions of a mixture over ``n_actions`` actions, to be compiled into the loop.

        mix(probs, work, point)    turns logits into μ in place (``strategies.mixture_probs``)
        draw(probs, u)             the action that ``u`` selects, and its probability
        first_largest(logits)      the first action of largest logit

    with ``point`` from ``load_point``. The number of actions is a compile-time constant.
    """
    return _compile_mix(n_actions), _compile_draw(n_actions), _compile_first_largest(n_actions)


def _compile_mix(n: int) -> Any:
    if n == 2:
        return _mix_two

    @kernel_function
    def mix(probs, work, point):
        greedy, soft, uniform, temperature = point[0], point[1], point[2], point[3]
        largest, legal = probs[0], _ZERO
        for k in range(n):
            largest = max(largest, probs[k])
            legal += np.float32(probs[k] != -np.inf)
        ties = total = _ZERO
        for k in range(n):
            ties += np.float32(probs[k] == largest)
            work[k] = exp32((probs[k] - largest) / temperature)
            total += work[k]
        best, any_legal = greedy * (_ONE / ties), uniform * (_ONE / legal)
        for k in range(n):
            mu = soft * (work[k] / total) if soft != 0 else _ZERO
            mu += best if probs[k] == largest else _ZERO
            probs[k] = mu + (any_legal if probs[k] != -np.inf else _ZERO)

    return mix


def _compile_draw(n: int) -> Any:
    @kernel_function
    def draw(probs, u):
        total = 0.0
        for k in range(n):
            total += np.float64(probs[k])
        point = u * total
        # Rounding may put the point at the total: then take the last action of positive
        # probability. An action whose interval is empty is never drawn.
        below, chosen, probability = 0.0, 0, probs[0]
        for k in range(1, n):
            below += np.float64(probs[k - 1])
            beyond = (below <= point) & (below < total)
            chosen = k if beyond else chosen
            probability = probs[k] if beyond else probability
        return chosen, probability

    return draw


def _compile_first_largest(n: int) -> Any:
    @kernel_function
    def first_largest(logits):
        chosen, largest = 0, logits[0]
        for k in range(1, n):
            larger = logits[k] > largest
            chosen = k if larger else chosen
            largest = logits[k] if larger else largest
        return chosen

    return first_largest
