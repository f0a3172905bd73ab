"""Whole episodes in machine code: environment, linear-softmax policy and mixture strategy in one.

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
from numpy.typing import NDArray

from trl_explore import kernels
from trl_explore.kernels import Kernel
from trl_explore.kernels.base import kernel_function
from trl_explore.kernels.borrow import borrow
from trl_explore.kernels.philox import STATE_SIZE, begin, philox_block, to_unit

GROUP = 32
"""How many episodes are stepped side by side."""
SCRATCH_BYTES = 1 << 22
"""The scratch of a group should stay in the processor's cache."""

SOURCES = (__file__, *(Path(kernels.__file__).with_name(f"{n}.py") for n in ("philox", "borrow")))
"""The files that are compiled into the loop, besides the kernel's own."""

_TINY, _HUGE = np.float32(np.finfo(np.float32).tiny), np.float32(np.finfo(np.float32).max)
_ZERO, _ONE = np.uint64(0), np.uint64(1)


class _Cache(FunctionCache):
    """numba's disk cache, with a key that knows the kernel that the loop was built around.

    numba's own key of a closure changes with every process, and does not notice that another file
    has changed; this one holds a hash of every file that is compiled into the loop.
    """

    digest = ""

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, codegen.magic_tuple(), self.digest


def scratch(kernel: Kernel, max_steps: int) -> tuple[NDArray[Any], ...]:
    """Memory for a group of episodes.

    Observation, action, μ(action), reward by episode and step; the number of steps, whether the
    last one terminated, and state, random stream and four action noises by episode.
    """
    per_episode = max_steps * (4 * kernel.n_features + 9)
    n = max(1, min(GROUP, SCRATCH_BYTES // per_episode))
    return (
        np.empty((n, max_steps, kernel.n_features), dtype=np.float32),
        np.empty((n, max_steps), dtype=np.int8 if kernel.n_actions < 128 else np.int64),
        np.empty((n, max_steps), dtype=np.float32),
        np.empty((n, max_steps), dtype=np.float32),
        np.empty(n, dtype=np.int64),
        np.empty(n, dtype=np.bool_),
        np.empty((n, kernel.state_size), dtype=np.float64),
        np.empty((n, STATE_SIZE), dtype=np.uint64),
        np.empty((n, 4), dtype=np.float64),
    )


def compile_loop(kernel: Kernel) -> Callable[..., tuple[int, int]]:
    """The episode loop around a kernel; compiled when first called, or loaded from disk.

    The function returned has the signature

        loop(parameters, trials, episodes, first_trial, env_key, action_key, weight, mixture,
             explore, memory, columns, start) -> (trials done, end)

    with trials and episodes [m] int64 (rows of ``weight`` and the numbers of their episodes),
    weight [*, n_actions, n_features] float32, mixture [4, 1 or *] float64 (greedy, softmax,
    uniform, temperature), explore whether to draw actions or to take the first of largest logit,
    memory the arrays of ``scratch``, and columns the arrays of ``fused.Columns``, which it fills
    from frame ``start`` on. It stops before a group of trials whose episodes do not fit.
    """
    functions = (kernel.reset, kernel.step, kernel.observe)
    return _compile(*functions, kernel.n_actions, kernel.n_features, kernel.digest)


@lru_cache(maxsize=32)
def _compile(  # noqa: C901 - four small functions that close over the kernel's
    reset: Any, step: Any, observe: Any, n_actions: int, n_features: int, digest: str
) -> Callable[..., tuple[int, int]]:
    @kernel_function
    def begin_episodes(group, episodes, first_trial, env_key, parameters, memory):
        state, rng = borrow(memory[6]), borrow(memory[7])
        for j in range(len(group)):
            trial = np.uint64(first_trial + group[j])
            begin(rng[j], env_key, np.uint64(episodes[j]), trial)
            reset(parameters, state[j], rng[j])

    @kernel_function
    def act(t, running, group, weight, mixture, explore, parameters, memory, probs, work):
        """Observe, and draw an action, in every running episode."""
        observation, action, chance = borrow(memory[0]), borrow(memory[1]), borrow(memory[2])
        state, noise = borrow(memory[6]), borrow(memory[8])
        for r in range(len(running)):
            j = running[r]
            row = group[j]
            x = observation[j, t]
            observe(parameters, state[j], x)
            for a in range(n_actions):
                logit = weight[row, a, 0] * x[0]
                for k in range(1, n_features):
                    logit += weight[row, a, k] * x[k]
                probs[a] = logit
            if explore:
                _mix(probs, work, mixture, row if mixture.shape[1] > 1 else 0)
                chosen = _draw(probs, noise[j, t & 3])
                chance[j, t] = probs[chosen]
            else:
                chosen = np.argmax(probs)
                chance[j, t] = 1
            action[j, t] = chosen

    @kernel_function
    def advance(t, running, parameters, memory):
        """Step every running episode; those that go on move to the front, and are counted."""
        action, reward, steps = borrow(memory[1]), borrow(memory[3]), borrow(memory[4])
        terminated, state, rng = borrow(memory[5]), borrow(memory[6]), borrow(memory[7])
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
        parameters, trials, episodes, first_trial, env_key, action_key, weight, mixture,
        explore, memory, columns, start,
    ):  # fmt: skip
        size = len(memory[4])
        own_running = np.empty(size, dtype=np.int64)
        own_probs = np.empty(n_actions, dtype=np.float32)
        own_work = np.empty(n_actions, dtype=np.float32)
        running, probs, work = borrow(own_running), borrow(own_probs), borrow(own_work)
        rows = borrow(weight)
        end = start
        for first in range(0, len(trials), size):
            group, numbers = trials[first : first + size], episodes[first : first + size]
            begin_episodes(group, numbers, first_trial, env_key, parameters, memory)
            left = len(group)
            for j in range(left):
                running[j] = j
            t = 0
            while left > 0:
                if t & 3 == 0:
                    _draw_noise(t, running[:left], group, numbers, first_trial, action_key, memory)
                act(
                    t, running[:left], group, rows, mixture, explore, parameters, memory,
                    probs, work,
                )  # fmt: skip
                left = advance(t, running[:left], parameters, memory)
                t += 1
            total = 0
            for j in range(len(group)):
                total += memory[4][j]
            if end + total > len(columns[0]):
                return first, end
            for j in range(len(group)):
                _deliver(memory, columns, j, group[j], end)
                end += memory[4][j]
        own_running[0] = np.int64(own_probs[0] + own_work[0])  # keeps them alive to here
        return len(trials), end

    compiled = nb.njit(nogil=True, error_model="numpy")(loop)
    cache = _Cache(loop)
    inlined = [Path(file).read_bytes() for file in SOURCES]
    parts = (*inlined, digest.encode(), repr((n_actions, n_features)).encode())
    cache.digest = hashlib.sha256(b"\0".join(parts)).hexdigest()
    compiled._cache = cache
    return compiled


@kernel_function
def _draw_noise(t, running, group, episodes, first_trial, action_key, memory):
    """The action noise of the steps t to t + 3, from each trial's own stream."""
    noise = borrow(memory[8])
    block = np.uint64(t >> 2) + _ONE
    for r in range(len(running)):
        j = running[r]
        b0, b1, b2, b3 = philox_block(
            action_key[0], action_key[1], block, _ZERO,
            np.uint64(episodes[j]), np.uint64(first_trial + group[j]),
        )  # fmt: skip
        noise[j, 0], noise[j, 1] = to_unit(b0), to_unit(b1)
        noise[j, 2], noise[j, 3] = to_unit(b2), to_unit(b3)


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
def _mix(probs, work, mixture, column):
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
        for k in range(n):
            work[k] += uniform * (np.float32(1) / np.float32(n))
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


@nb.njit(error_model="numpy")
def _deliver(memory, columns, j, row, start):
    """Write episode j of a group to the frames from ``start`` on."""
    x, a, chance, r, steps, ended = memory[:6]
    (trial, observation, action, action_log_prob, reward, done, terminated, truncated,
     step_count, episode_reward) = columns  # fmt: skip
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
    total = np.float32(0)
    for t in range(n):
        total += r[j, t]
        episode_reward[start + t] = total
    last = start + n - 1
    done[last] = True
    terminated[last] = ended[j]
    truncated[last] = n == x.shape[1]
