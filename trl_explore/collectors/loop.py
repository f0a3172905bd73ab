"""Whole episodes in machine code: environment, linear-softmax policy and mixture strategy in one.

``compile_loop`` builds the loop for one kernel. Each operation is that of the TorchRL collector,
in the same order and precision: states in float64, observations, logits and probabilities in
float32, the inverse CDF in float64.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba as nb
import numpy as np
from numba.core.caching import FunctionCache

from trl_explore.kernels import Kernel
from trl_explore.kernels.philox import STATE_SIZE, begin, philox_block, to_unit

_TINY = np.float32(np.finfo(np.float32).tiny)
_ZERO, _ONE = np.uint64(0), np.uint64(1)


class _Cache(FunctionCache):
    """numba's disk cache, with a key that knows the kernel that the loop was built around.

    numba's own key of a closure changes with every process, and does not notice that another file
    has changed.
    """

    digest = ""

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, codegen.magic_tuple(), self.digest


def compile_loop(kernel: Kernel) -> Callable[..., tuple[int, int]]:
    """The episode loop around a kernel; compiled when first called, or loaded from disk.

    The function returned has the signature

        loop(parameters, trials, episodes, first_trial, env_key, action_key, weight, mixture,
             max_steps, columns, start, capacity) -> (trials done, end)

    with trials and episodes [m] int64 (rows of ``weight`` and numbers of their episodes), weight
    [*, n_actions, n_features] float32, mixture [4, 1 or *] float64 (greedy, softmax, uniform,
    temperature), and columns the arrays of ``fused.Columns``, which it fills from frame ``start``
    on. It stops before a trial whose episode might not fit below ``capacity``.
    """
    functions = (kernel.reset, kernel.step, kernel.observe)
    return _compile(*functions, kernel.n_actions, kernel.state_size, kernel.digest)


@lru_cache(maxsize=32)
def _compile(
    reset: Any, step: Any, observe: Any, n_actions: int, state_size: int, digest: str
) -> Callable[..., tuple[int, int]]:
    def loop(
        parameters, trials, episodes, first_trial, env_key, action_key, weight, mixture,
        max_steps, columns, start, capacity,
    ):  # fmt: skip
        (trial, observation, action, action_log_prob, reward, done, terminated, truncated,
         step_count, episode_reward) = columns  # fmt: skip
        n_features = weight.shape[2]
        probs = np.empty(n_actions, dtype=np.float32)
        noise = np.empty(4, dtype=np.float64)
        state = np.empty(state_size, dtype=np.float64)
        rng = np.empty(STATE_SIZE, dtype=np.uint64)
        per_trial = mixture.shape[1] > 1
        i = start
        for m in range(len(trials)):
            if i + max_steps > capacity:
                return m, i
            row = trials[m]
            w = weight[row]
            column = row if per_trial else 0
            greedy, soft = np.float32(mixture[0, column]), np.float32(mixture[1, column])
            uniform = np.float32(mixture[2, column])
            temperature = max(np.float32(mixture[3, column]), _TINY)
            word = np.uint64(first_trial + row)
            episode = np.uint64(episodes[m])
            begin(rng, env_key, episode, word)
            reset(parameters, state, rng)
            total_reward = np.float32(0)
            for t in range(max_steps):
                x = observation[i]
                observe(parameters, state, x)
                for a in range(n_actions):
                    logit = w[a, 0] * x[0]
                    for k in range(1, n_features):
                        logit += w[a, k] * x[k]
                    probs[a] = logit
                _mix(probs, greedy, soft, uniform, temperature)
                place = t & 3
                if place == 0:
                    block = np.uint64(t >> 2) + _ONE
                    b0, b1, b2, b3 = philox_block(
                        action_key[0], action_key[1], block, _ZERO, episode, word
                    )
                    noise[0], noise[1] = to_unit(b0), to_unit(b1)
                    noise[2], noise[3] = to_unit(b2), to_unit(b3)
                chosen = _draw(probs, noise[place])
                r, end = step(parameters, state, chosen, rng)
                total_reward += np.float32(r)
                last = t + 1 == max_steps
                trial[i] = row
                action[i] = chosen
                action_log_prob[i] = math.log(probs[chosen])
                reward[i] = r
                terminated[i] = end
                truncated[i] = last
                done[i] = end or last
                step_count[i] = t + 1
                episode_reward[i] = total_reward
                i += 1
                if end:
                    break
        return len(trials), i

    compiled = nb.njit(nogil=True)(loop)
    cache = _Cache(loop)
    own = Path(__file__).read_bytes()
    cache.digest = hashlib.sha256(
        own + digest.encode() + repr((n_actions, state_size)).encode()
    ).hexdigest()
    compiled._cache = cache
    return compiled


@nb.njit(cache=True)
def _mix(probs, greedy, soft, uniform, temperature):
    """Turn logits into μ in place (``strategies.mixture_probs``)."""
    n = len(probs)
    largest = probs[0]
    for k in range(1, n):
        largest = max(largest, probs[k])
    ties = np.float32(0)
    total = np.float32(0)
    if greedy != 0:
        for k in range(n):
            ties += np.float32(probs[k] == largest)
    if soft != 0:
        for k in range(n):
            total += np.float32(math.exp((probs[k] - largest) / temperature))
    for k in range(n):
        p = np.float32(0)
        if greedy != 0:
            p += greedy * (np.float32(probs[k] == largest) / ties)
        if soft != 0:
            p += soft * (np.float32(math.exp((probs[k] - largest) / temperature)) / total)
        if uniform != 0:
            p += uniform * (np.float32(1) / np.float32(n))
        probs[k] = p


@nb.njit(cache=True)
def _draw(probs, u):
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
