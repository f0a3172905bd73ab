"""The memory of the episode loop: SIMD lanes on the stack, and the scratch for their frames.

In this package a lane is a column of arrays on the stack, which runs one episode after another;
elsewhere, a lane is the place of a trial in a batch (dimension 0). The scratch holds the frames of
a group of running episodes; whole episodes are copied from it to the data.
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from typing import Any, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from trl_explore.collectors.compiled_policies import Network
from trl_explore.envs.kernels import Kernel
from trl_explore.numerics.compiled.arrays import borrow, one_by_one
from trl_explore.numerics.compiled.cache import kernel_function
from trl_explore.numerics.compiled.elementary import log32
from trl_explore.numerics.compiled.philox import philox_block, to_unit

LANES = 64
"""The number of episodes stepped side by side."""
GROUP = 2 * LANES
"""The number of episodes that run in the SIMD lanes before they are copied to the data."""
UNRECORDED = 1 << 12
"""The number of episodes in a group without records, which only needs memory for outcomes."""
NARROW = 8
"""An observation of at most this many features is kept in the SIMD lanes."""
SCRATCH_BYTES = 1 << 22
"""The scratch of a group should stay in the processor's cache."""

_ZERO, _ONE = np.uint64(0), np.uint64(1)

part = nb.njit(inline="always", nogil=True, error_model="numpy")
"""Decorator of a part of the loop: always inlined, so that the compiler sees the lanes' arrays."""


class Lanes(NamedTuple):
    """Everything that a step of an episode reads and writes, [..., LANES], on the stack."""

    state: Any  # state of the kernel [state_size]
    rng: Any  # random stream of the environment [STATE_SIZE]
    noise: Any  # action noise of four steps, uniform in [0, 1) [4]
    point: Any  # mixture weights of argmax, softmax and uniform, and temperature [4]
    local: Any  # weights of the policy [network.local]
    x: Any  # observation [n_features]
    probs: Any  # logits, then μ [n_actions]
    work: Any  # work space [n_actions]
    place: Any  # indices of the episode, see the constants below [6]
    value: Any  # reward, sum of rewards, and μ(action) [3]
    score: Any  # sum of rewards, in double []
    over: Any  # whether the episode has terminated []


SLOT, WEIGHT_SLOT, ROW, ACTION, FRAME, END = range(6)
"""In ``Lanes.place``: the episode's slot in the scratch, the slot of its policy's weights, the row
of its trial, its action, its present frame in the scratch, and the end of its part there."""


@part
def clear(lanes):
    """Assign each lane a weight slot; initialise the buffers that are read before written."""
    lanes.x[:] = 0
    lanes.local[:] = 0
    lanes.point[:] = 1
    lanes.noise[:] = 0
    for j in range(LANES):
        lanes.place[WEIGHT_SLOT, j] = j


@part
def draw_noise(left, max_steps, episodes, first_trial, action_key, lanes):
    """Draw the action noise of the next four steps from each trial's stream."""
    for j in range(left):
        slot = lanes.place[SLOT, j]
        t = lanes.place[FRAME, j] - slot * max_steps
        words = philox_block(
            action_key[0], action_key[1], np.uint64(t >> 2) + _ONE, _ZERO,
            np.uint64(episodes[slot]), np.uint64(first_trial + lanes.place[ROW, j]),
        )  # fmt: skip
        for i in range(4):
            lanes.noise[i, j] = to_unit(words[i])
        one_by_one()  # vectorising 64-bit products does not pay


@part
def retire(left, max_steps, scratch, lanes):
    """Remove the lanes whose episode has ended; the last lanes move to their places."""
    j = 0
    while j < left:
        frame = lanes.place[FRAME, j]
        if not lanes.over[j] and frame < lanes.place[END, j]:
            j += 1
            continue
        slot, weight_slot = lanes.place[SLOT, j], lanes.place[WEIGHT_SLOT, j]
        scratch.steps[slot], scratch.ended[slot] = frame - slot * max_steps, lanes.over[j]
        scratch.score[slot] = lanes.score[j]
        left -= 1
        lanes.over[j], lanes.score[j] = lanes.over[left], lanes.score[left]
        for i in range(6):
            lanes.place[i, j] = lanes.place[i, left]
        for i in range(3):
            lanes.value[i, j] = lanes.value[i, left]
        for i in range(4):
            lanes.noise[i, j], lanes.point[i, j] = lanes.noise[i, left], lanes.point[i, left]
        for i in range(lanes.state.shape[0]):
            lanes.state[i, j] = lanes.state[i, left]
        for i in range(lanes.rng.shape[0]):
            lanes.rng[i, j] = lanes.rng[i, left]
        for i in range(lanes.local.shape[0]):
            lanes.local[i, j] = lanes.local[i, left]
        lanes.place[WEIGHT_SLOT, left] = weight_slot
    return left


class Scratch(NamedTuple):
    """The frames of a group of episodes, each in its slot, and memory for their policies."""

    frames: NDArray[np.float32]
    """Per frame: reward, sum of rewards, μ(action), action, and the observation if it is narrow
    [slots * max_steps * (4 + n_features or 0)]."""
    observation: NDArray[np.float32]
    """[slots * max_steps * n_features]; empty if the observation is narrow."""
    allowed: NDArray[np.bool_]
    """Action mask [slots * max_steps * n_actions]; empty if there is none."""
    steps: NDArray[np.int64]  # the number of frames [slots]
    ended: NDArray[np.bool_]  # whether the last frame terminated the episode [slots]
    score: NDArray[np.float64]  # the sum of the rewards, in double [slots]
    own: Any  # ``own`` and ``hidden`` of ``Network.memory``, with one weight slot per SIMD lane
    hidden: NDArray[np.float32]


def scratch(
    kernel: Kernel,
    network: Network,
    max_steps: int,
    masked: bool,
    episodes: int = GROUP,
    *,
    records: bool = True,
) -> tuple[tuple[Any, ...], int, int]:
    """The fields of a ``Scratch`` for at most ``episodes``, the number of lanes and ``max_steps``.

    The operating system provides memory on first use, so unused parts cost nothing.
    """
    n_masks = kernel.n_actions if masked else 0
    per_frame = 4 * (4 + kernel.n_features) + n_masks
    slots = max(1, min(GROUP, SCRATCH_BYTES // (max_steps * per_frame), episodes))
    lanes = min(LANES, slots, network.group())
    n = slots * max_steps
    if not records:  # one observation and one mask per lane
        slots, n = UNRECORDED, lanes
    narrow = is_narrow(network, masked)
    own, hidden = network.memory(lanes)
    memory = Scratch(
        np.empty(records * n * (4 + narrow * kernel.n_features), dtype=np.float32),
        np.empty(n * (not narrow) * kernel.n_features, dtype=np.float32),
        np.empty(n * n_masks, dtype=np.bool_),
        np.empty(slots, dtype=np.int64),
        np.empty(slots, dtype=np.bool_),
        np.empty(slots, dtype=np.float64),
        own,
        hidden,
    )
    return tuple(memory), lanes, max_steps


def is_narrow(network: Network, masked: bool) -> bool:
    """Whether an observation is kept in the SIMD lanes; others are written to the scratch."""
    return network.sizes[0] <= NARROW and network.local > 0 and not masked


@kernel_function
def row_of(frames, lanes, j, size):
    """The frame of lane j in a column of the scratch that has ``size`` entries per frame."""
    start = lanes.place[FRAME, j] * size
    return borrow(frames)[start : start + size]


@kernel_function
def only_row_of(frames, lanes, j, size):
    """The only frame of lane j that a loop without records keeps."""
    return borrow(frames)[j * size : (j + 1) * size]


def compile_deliver(record: int, narrow: bool, n_features: int, n_masks: int) -> Any:
    """The function that copies the episode in a slot to the data, from frame ``start`` on.

    Separate loops over the columns become vector instructions.
    """

    @kernel_function
    def deliver(scratch, columns, slot, max_steps, row, start):
        n, first = scratch.steps[slot], slot * max_steps
        end = start + n
        frames = borrow(scratch.frames)[first * record : (first + n) * record]
        (trial, observation, action, action_log_prob, reward, done, terminated, truncated,
         step_count, episode_reward, action_mask) = columns  # fmt: skip
        to, total = borrow(reward)[start:end], borrow(episode_reward)[start:end]
        log, choice = borrow(action_log_prob)[start:end], borrow(action)[start:end]
        x = borrow(observation)[start * n_features : end * n_features]
        for t in range(n):
            to[t] = frames[t * record]
            total[t] = frames[t * record + 1]
            log[t] = frames[t * record + 2]
            choice[t] = np.int64(frames[t * record + 3])
            if narrow:
                for k in range(n_features):
                    x[t * n_features + k] = frames[t * record + 4 + k]
        for t in range(n):
            log[t] = log32(log[t])
        if not narrow:
            copy(scratch.observation, observation, first, start, n, n_features)
        if n_masks:
            copy(scratch.allowed, action_mask, first, start, n, n_masks)
        to_trial, step = borrow(trial)[start:end], borrow(step_count)[start:end]
        for t in range(n):
            to_trial[t] = row
            step[t] = t + 1
        borrow(done)[start:end] = False
        borrow(terminated)[start:end] = False
        borrow(truncated)[start:end] = False
        done[end - 1] = True
        terminated[end - 1] = scratch.ended[slot]
        truncated[end - 1] = n == max_steps

    return deliver


@kernel_function
def copy(source, target, first, start, n, size):
    """Copy n frames of the scratch, from ``first`` on, to a column, from ``start`` on."""
    of = borrow(source)[first * size : (first + n) * size]
    to = borrow(target)[start * size : (start + n) * size]
    for i in range(len(to)):
        to[i] = of[i]
