"""Whole episodes in machine code: environment, policy and mixture strategy in one.

Each operation is that of the TorchRL collector, in the same order and precision: states in
float64, observations, logits and probabilities in float32, the inverse CDF in float64.

A step of an environment is a chain of operations that wait for each other. Episodes of several
trials are therefore stepped side by side, so that the processor always has another one to work on;
each writes to a scratch of its own, from where whole episodes go to the data, in order of trials.
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

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

from trl_explore import kernels, ops
from trl_explore.collectors import mixing, networks
from trl_explore.collectors.mixing import draw, mix
from trl_explore.collectors.networks import Network, compile_network
from trl_explore.kernels import Kernel
from trl_explore.kernels.base import kernel_function
from trl_explore.kernels.borrow import borrow
from trl_explore.kernels.philox import STATE_SIZE, begin, philox_block, to_unit

GROUP = 32
"""How many episodes are stepped side by side."""
SCRATCH_BYTES = 1 << 22
"""The scratch of a group should stay in the processor's cache."""

SOURCES = (
    *(__file__, mixing.__file__, networks.__file__),
    *(Path(kernels.__file__).with_name(f"{name}.py") for name in ("philox", "borrow")),
    *(Path(ops.__file__).with_name(f"{name}.py") for name in ("activation", "linear")),
)
"""The files that are compiled into the loop, besides the kernel's own."""

_ZERO, _ONE = np.uint64(0), np.uint64(1)


class _Cache(FunctionCache):
    """numba's disk cache, with a key that knows the kernel that the loop was built around.

    numba's own key of a closure changes with every process, and does not notice that another file
    has changed; this one holds a hash of every file that is compiled into the loop.
    """

    digest = ""

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, codegen.magic_tuple(), self.digest


def scratch(kernel: Kernel, network: Network, max_steps: int, masked: bool) -> tuple[Any, ...]:
    """Memory for a group of episodes.

    Observation, action, μ(action), reward, action mask by episode and step; the number of steps,
    whether the last one terminated, and state, random stream and four action noises by episode;
    the weights of the policy by episode, and its hidden units.
    """
    n_masks = kernel.n_actions if masked else 0
    per_episode = max_steps * (4 * kernel.n_features + 9 + n_masks)
    n = max(1, min(GROUP, SCRATCH_BYTES // per_episode, network.group()))
    return (
        np.empty((n, max_steps, kernel.n_features), dtype=np.float32),
        np.empty((n, max_steps), dtype=np.int8 if kernel.n_actions < 128 else np.int64),
        np.empty((n, max_steps), dtype=np.float32),
        np.empty((n, max_steps), dtype=np.float32),
        np.empty((n, max_steps, n_masks), dtype=np.bool_),
        np.empty(n, dtype=np.int64),
        np.empty(n, dtype=np.bool_),
        np.empty((n, kernel.state_size), dtype=np.float64),
        np.empty((n, STATE_SIZE), dtype=np.uint64),
        np.empty((n, 4), dtype=np.float64),
        *network.memory(n),
    )


def compile_loop(
    kernel: Kernel, network: Network, masked: bool = False
) -> Callable[..., tuple[int, int]]:
    """The episode loop around a kernel and a policy; compiled when first called, or from disk.

    The function returned has the signature

        loop(parameters, trials, episodes, first_trial, env_key, action_key, weights, mixture,
             explore, memory, columns, start) -> (trials done, end)

    with trials and episodes [m] int64 (rows of the weights and the numbers of their episodes),
    weights of ``networks.arrays``, mixture [4, 1 or *] float64 (greedy, softmax, uniform,
    temperature), explore whether to draw actions or to take the first of largest logit, memory of
    ``scratch``, and columns the arrays of ``fused.Columns``, which it fills from frame ``start``
    on. It stops before a group of trials whose episodes do not fit.

    Args:
        kernel: the environment.
        network: the policy.
        masked: whether the kernel's action masks are obeyed, and written to the columns.
    """
    functions = (kernel.reset, kernel.step, kernel.observe, kernel.mask if masked else None)
    return _compile(*functions, network, kernel.digest)


@lru_cache(maxsize=32)
def _compile(  # noqa: C901 - small functions that close over the kernel's and the policy's
    reset: Any, step: Any, observe: Any, mask: Any, network: Network, digest: str
) -> Callable[..., tuple[int, int]]:
    n_actions = network.sizes[-1]
    masked, allow = mask is not None, _all_allowed if mask is None else mask
    load, logits = compile_network(network)

    @kernel_function
    def begin_episodes(group, episodes, first_trial, env_key, weights, parameters, memory):
        state, rng = borrow(memory[7]), borrow(memory[8])
        for j in range(len(group)):
            trial = np.uint64(first_trial + group[j])
            begin(rng[j], env_key, np.uint64(episodes[j]), trial)
            reset(parameters, state[j], rng[j])
            load(weights, group[j], j, memory[10])

    @kernel_function
    def act(t, running, group, weights, mixture, explore, parameters, memory, probs, work):
        """Observe, and draw an action, in every running episode."""
        observation, action, chance = borrow(memory[0]), borrow(memory[1]), borrow(memory[2])
        allowed, state, noise = borrow(memory[4]), borrow(memory[7]), borrow(memory[9])
        for r in range(len(running)):
            j = running[r]
            row = group[j]
            x = observation[j, t]
            observe(parameters, state[j], x)
            logits(weights, row, j, memory[10], memory[11], x, probs)
            if masked:
                legal = allowed[j, t]
                allow(parameters, state[j], legal)
                for a in range(n_actions):
                    probs[a] = probs[a] if legal[a] else -np.inf
            if explore:
                mix(probs, work, mixture, row if mixture.shape[1] > 1 else 0)
                chosen = draw(probs, noise[j, t & 3])
                chance[j, t] = probs[chosen]
            else:
                chosen = np.argmax(probs)
                chance[j, t] = 1
            action[j, t] = chosen

    @kernel_function
    def advance(t, running, parameters, memory):
        """Step every running episode; those that go on move to the front, and are counted."""
        action, reward, steps = borrow(memory[1]), borrow(memory[3]), borrow(memory[5])
        terminated, state, rng = borrow(memory[6]), borrow(memory[7]), borrow(memory[8])
        left = 0
        for r in range(len(running)):
            j = running[r]
            reward[j, t], terminal = step(parameters, state[j], action[j, t], rng[j])
            terminated[j] = terminal
            steps[j] = t + 1
            if not terminal and t + 1 < action.shape[1]:
                running[left] = j
                left += 1
        return left

    def loop(
        parameters, trials, episodes, first_trial, env_key, action_key, weights, mixture,
        explore, memory, columns, start,
    ):  # fmt: skip
        size = len(memory[5])
        own_running = np.empty(size, dtype=np.int64)
        own_probs = np.empty(n_actions, dtype=np.float32)
        own_work = np.empty(n_actions, dtype=np.float32)
        running, probs, work = borrow(own_running), borrow(own_probs), borrow(own_work)
        end = start
        for first in range(0, len(trials), size):
            group, numbers = trials[first : first + size], episodes[first : first + size]
            begin_episodes(group, numbers, first_trial, env_key, weights, parameters, memory)
            left = len(group)
            for j in range(left):
                running[j] = j
            t = 0
            while left > 0:
                if t & 3 == 0:
                    _draw_noise(t, running[:left], group, numbers, first_trial, action_key, memory)
                act(
                    t, running[:left], group, weights, mixture, explore, parameters, memory,
                    probs, work,
                )  # fmt: skip
                left = advance(t, running[:left], parameters, memory)
                t += 1
            total = 0
            for j in range(len(group)):
                total += memory[5][j]
            if end + total > len(columns[0]):
                return first, end
            for j in range(len(group)):
                _deliver(memory, columns, j, group[j], end)
                end += memory[5][j]
        own_running[0] = np.int64(own_probs[0] + own_work[0])  # keeps them alive to here
        return len(trials), end

    compiled = nb.njit(nogil=True, error_model="numpy")(loop)
    cache = _Cache(loop)
    inlined = [Path(file).read_bytes() for file in SOURCES]
    parts = (*inlined, digest.encode(), repr((network, masked)).encode())
    cache.digest = hashlib.sha256(b"\0".join(parts)).hexdigest()
    compiled._cache = cache
    return compiled


@kernel_function
def _all_allowed(parameters, state, mask):
    """Stands for the action mask where there is none; never called."""


@kernel_function
def _draw_noise(t, running, group, episodes, first_trial, action_key, memory):
    """The action noise of the steps t to t + 3, from each trial's own stream."""
    noise = borrow(memory[9])
    block = np.uint64(t >> 2) + _ONE
    for r in range(len(running)):
        j = running[r]
        b0, b1, b2, b3 = philox_block(
            action_key[0], action_key[1], block, _ZERO,
            np.uint64(episodes[j]), np.uint64(first_trial + group[j]),
        )  # fmt: skip
        noise[j, 0], noise[j, 1] = to_unit(b0), to_unit(b1)
        noise[j, 2], noise[j, 3] = to_unit(b2), to_unit(b3)


@nb.njit(error_model="numpy")
def _deliver(memory, columns, j, row, start):  # noqa: C901 - one loop for each column
    """Write episode j of a group to the frames from ``start`` on."""
    x, a, chance, r, allowed, steps, ended = memory[:7]
    (trial, observation, action, action_log_prob, reward, done, terminated, truncated,
     step_count, episode_reward, action_mask) = columns  # fmt: skip
    n = steps[j]
    for t in range(n):  # one loop for each column: the simple ones become vector instructions
        trial[start + t] = row
    for t in range(n):
        for k in range(observation.shape[1]):
            observation[start + t, k] = x[j, t, k]
    for t in range(n):
        action[start + t] = a[j, t]
    for t in range(n):
        action_log_prob[start + t] = math.log(chance[j, t])
    for t in range(n):
        reward[start + t] = r[j, t]
    for t in range(n):
        done[start + t] = terminated[start + t] = truncated[start + t] = False
    for t in range(n):
        step_count[start + t] = t + 1
    for t in range(n):
        for k in range(action_mask.shape[1]):
            action_mask[start + t, k] = allowed[j, t, k]
    total = np.float32(0)
    for t in range(n):
        total += r[j, t]
        episode_reward[start + t] = total
    last = start + n - 1
    done[last] = True
    terminated[last] = ended[j]
    truncated[last] = n == x.shape[1]
