"""The SIMD lanes of the episode loop: arrays on the stack whose last dimension is the lane.

In this package a lane is such a column, which runs one episode after another; elsewhere, a lane is
the place of a trial in a batch (dimension 0).
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from typing import Any, NamedTuple

import numba as nb
import numpy as np

from trl_explore.numerics.compiled.arrays import one_by_one
from trl_explore.numerics.compiled.philox import philox_block, to_unit

LANES = 64
"""The number of episodes stepped side by side."""

_ZERO, _ONE = np.uint64(0), np.uint64(1)

part = nb.njit(inline="always", nogil=True, error_model="numpy")
"""Decorator of a part of the loop: always inlined, so that the compiler sees the lanes' arrays."""


class Lanes(NamedTuple):
    """Everything that a step of an episode reads and writes, [..., LANES], on the stack."""

    state: Any
    """State of the kernel [state_size]."""
    rng: Any
    """Random stream of the environment [STATE_SIZE]."""
    noise: Any
    """Action noise of four steps, uniform in [0, 1) [4]."""
    point: Any
    """Mixture weights of argmax, softmax and uniform, and temperature [4]."""
    local: Any
    """Weights of the policy [network.local]."""
    x: Any
    """Observation [n_features]."""
    probs: Any
    """Logits, then μ [n_actions]."""
    work: Any
    """Work space [n_actions]."""
    place: Any
    """Indices of the episode, see the constants below [6]."""
    value: Any
    """Reward, sum of rewards, and μ(action) [3]."""
    score: Any
    """Sum of rewards, in double []."""
    over: Any
    """Whether the episode has terminated []."""


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
