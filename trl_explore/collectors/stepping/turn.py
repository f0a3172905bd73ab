"""One turn of all running lanes in machine code, and the order of the frames.

A turn records what the environments have returned for the last actions, drops the lanes whose
episode has ended, and chooses the next actions. Frames are logged step by step; ``deliver`` copies
them to the columns trial by trial.
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from trl_explore.collectors import compiled_mixtures, compiled_policies
from trl_explore.collectors.columns import ColumnTypes
from trl_explore.collectors.stepping import acting
from trl_explore.collectors.stepping.acting import Form, compile_acting
from trl_explore.numerics.compiled import arrays, elementary, layers, philox
from trl_explore.numerics.compiled.arrays import borrow
from trl_explore.numerics.compiled.cache import compiled, kernel_function
from trl_explore.numerics.compiled.philox import STATE_SIZE, begin

BEGIN, RECORD, ACT = 1, 2, 4
"""The parts of a turn."""


class State(NamedTuple):
    """What the lanes carry from turn to turn."""

    rows: Any  # the running lanes, in ascending order [trials]; the first ``left`` count
    episodes: Any  # the number of the episode of each lane [trials]
    rng: Any  # the stream of action noise of each lane [trials, STATE_SIZE]
    action: Any  # the actions of the running lanes, flat [trials * max(1, n_dims)]
    score: Any  # sum of rewards of each lane, in double [trials]
    total: Any  # the same sum in single precision, as ``RewardSum`` computes it [trials]
    length: Any  # frames of each lane's episode [trials]
    point: Any  # weights of argmax, softmax and uniform, and temperature of each lane [trials, 4]
    scale: Any  # standard deviations of each lane's Gaussian [trials, n_dims]
    local: Any  # weights of small linear policies [trials, network.local]
    own: Any  # weights of the other networks, from ``Network.memory``, and work space
    hidden: Any
    out: Any  # logits, then μ [n_actions]; or loc [n_dims]
    work: Any  # work space [n_actions]
    noise: Any  # noise of one frame [n_dims + 1]
    given: Any  # actions written by torch modules, flat [trials * max(1, n_dims)]
    given_log_prob: Any  # their log-probabilities [trials]

    @classmethod
    def of(cls, form: Form, trials: int) -> State:
        """The arrays for ``trials`` lanes."""
        network, size = form.network, max(1, form.n_dims)
        number = np.float32 if form.n_dims else np.int64
        n_out = network.sizes[-1] if network else 0
        own, hidden = network.memory(trials) if network else ((), np.empty((0, 0), np.float32))
        return cls(
            np.zeros(trials, np.int64),
            np.zeros(trials, np.int64),
            np.zeros((trials, STATE_SIZE), np.uint64),
            np.zeros(trials * size, number),
            np.zeros(trials),
            np.zeros(trials, np.float32),
            np.zeros(trials, np.int64),
            np.zeros((trials, 4), np.float32),
            np.zeros((trials, form.n_dims), np.float32),
            np.zeros((trials, network.local if network else 0), np.float32),
            own,
            hidden,
            np.zeros(n_out, np.float32),
            np.zeros(n_out, np.float32),
            np.zeros(form.n_dims + 1),
            np.zeros(trials * size, number),
            np.zeros(trials, np.float32),
        )


class FrameLog(NamedTuple):
    """The frames of all lanes in the order of the steps, flat."""

    row: Any
    observation: Any
    action: Any
    log_prob: Any
    mask: Any
    reward: Any
    total: Any  # sum of rewards up to this frame
    ended: Any  # 1: terminated, 2: truncated, 3: both, 0: the episode goes on


def log_types(form: Form) -> ColumnTypes:
    """The columns of a ``FrameLog``."""
    kinds: list[tuple[int, Any]] = [
        (1, np.int64),
        (form.n_features, np.float32),
        (form.n_dims or 1, np.float32 if form.n_dims else np.int64),
        (int(form.exact), np.float32),
        (form.n_masks, np.bool_),
        (1, np.float32),
        (1, np.float32),
        (1, np.uint8),
    ]
    names = zip(FrameLog._fields, kinds, strict=True)
    return tuple((name, size, dtype) for name, (size, dtype) in names)


@lru_cache(maxsize=32)
def compile_turn(  # noqa: C901 - the parts of one compiled function
    form: Form,
) -> Callable[..., tuple[int, int]]:
    """The turn of a form; compiled on the first call, or read from disk.

        turn(parts, explore, first_trial, place, left, key, weights, mixture, box, outputs,
             state, log) -> (left, place)

    with

        parts       BEGIN: prepare the first ``left`` lanes of ``state.rows`` for an episode;
                    RECORD: record the outputs of the last actions, whose frames are at ``place``;
                    ACT: choose actions and log the new frames from ``place`` on
        explore     whether to draw actions; if not, the first action of largest logit, or the mean
        key         Philox key of the action noise
        weights     from ``compiled_policies.arrays``
        mixture     [4, 1 or trials] float64: the strategy's weights and temperature
        box         lower and upper bounds of a continuous action, and [log of their volume]
        outputs     observation, reward, terminated, truncated and mask of the lanes
        state, log  the fields of a ``State`` and of a ``FrameLog``

    It returns the number of running lanes and the next place.
    """
    load, act = compile_acting(form)
    n_features, n_masks = form.n_features, form.n_masks

    @kernel_function
    def record(place, left, outputs, state, log):
        """Record the outputs of the lanes; returns the number of those that go on."""
        _, reward, terminated, truncated, _ = outputs
        kept = 0
        for j in range(left):
            row, frame = state.rows[j], place + j
            state.score[row] += reward[row]
            state.total[row] += np.float32(reward[row])
            state.length[row] += 1
            log.reward[frame], log.total[frame] = reward[row], state.total[row]
            ended = np.uint8(terminated[row]) + np.uint8(2) * np.uint8(truncated[row])
            log.ended[frame] = ended
            if ended == 0:
                state.rows[kept] = row
                kept += 1
        return kept

    @kernel_function
    def observe(place, left, outputs, state, log):
        """Log the observations and masks."""
        observation, mask = outputs[0], outputs[4]
        for j in range(left):
            row, frame = state.rows[j], place + j
            x = borrow(observation)[row]
            to = borrow(log.observation)[frame * n_features : (frame + 1) * n_features]
            for k in range(n_features):
                to[k] = x[k]
            log.row[frame] = row
            for a in range(n_masks):
                log.mask[frame * n_masks + a] = mask[row, a]

    def turn(
        parts, explore, first_trial, place, left, key, weights, mixture, box, outputs, state, log
    ):
        # Not passed as named tuples: numba cannot read its cache after a class has moved.
        state, log = State(*state), FrameLog(*log)
        if parts & BEGIN:
            for j in range(left):
                row = state.rows[j]
                stream = np.uint64(state.episodes[row]), np.uint64(first_trial + row)
                begin(borrow(state.rng)[row], key, *stream)
                load(row, weights, mixture, state)
                state.score[row], state.total[row], state.length[row] = 0, 0, 0
        if parts & RECORD:
            went = left
            left = record(place, left, outputs, state, log)
            place += went
        if parts & (BEGIN | RECORD):
            observe(place, left, outputs, state, log)
        if parts & ACT:
            for j in range(left):
                act(j, state.rows[j], place + j, explore, weights, mixture, box, state, log)
        return left, place

    inlined = (acting, compiled_mixtures, compiled_policies, arrays, elementary, layers, philox)
    return compiled(*inlined, key=form)(turn)


@compiled()
def deliver(count, n_features, size, n_masks, exact, starts, steps, log, columns):
    """Copy ``count`` frames from the log to the columns (``Columns.arrays``), trial by trial.

    ``starts`` [trials] has the first frame of each lane and ``steps`` [trials] zeros; both change.
    """
    row_of, observation, action, log_prob, mask, reward, total, ended = log
    (to_trial, to_observation, to_action, to_log_prob, to_reward, to_done, to_terminated,
     to_truncated, to_step, to_total, to_mask) = columns  # fmt: skip
    for i in range(count):
        row = row_of[i]
        to = starts[row]
        starts[row] += 1
        steps[row] += 1
        to_trial[to], to_step[to] = row, steps[row]
        for k in range(n_features):
            to_observation[to * n_features + k] = observation[i * n_features + k]
        for k in range(size):
            to_action[to * size + k] = action[i * size + k]
        for k in range(n_masks):
            to_mask[to * n_masks + k] = mask[i * n_masks + k]
        if exact:
            to_log_prob[to] = log_prob[i]
        to_reward[to], to_total[to] = reward[i], total[i]
        to_done[to] = ended[i] != 0
        to_terminated[to] = (ended[i] & 1) != 0
        to_truncated[to] = (ended[i] & 2) != 0
        if ended[i] != 0:
            steps[row] = 0
