"""Whole episodes in machine code: environment, policy and mixture strategy in one loop.

The operations are those of the TorchRL collector, in the same order and precision: states in
float64, observations, logits and probabilities in float32, the inverse CDF in float64.

Episodes of many trials are stepped side by side, each in a SIMD lane. All that a step reads and
writes is on the stack, with the lane as the last dimension, so that a loop over lanes becomes
vector instructions if kernel, policy and strategy neither branch nor call. Frames are written to
the group's scratch; whole episodes are copied from there to the data, in order of trials. A loop
without records keeps no frames, only the outcome of each episode.
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numba as nb
import numpy as np

from trl_explore.collectors import compiled_mixtures, compiled_policies
from trl_explore.collectors.compiled_mixtures import compile_mixing, load_point
from trl_explore.collectors.compiled_policies import Network, compile_network
from trl_explore.collectors.fused import memory as memory_module
from trl_explore.collectors.fused.memory import (
    ACTION,
    END,
    FRAME,
    LANES,
    ROW,
    SLOT,
    WEIGHT_SLOT,
    Lanes,
    Scratch,
    clear,
    compile_deliver,
    draw_noise,
    is_narrow,
    only_row_of,
    part,
    retire,
    row_of,
)
from trl_explore.envs.kernels import Kernel
from trl_explore.numerics.compiled import arrays, elementary, layers, philox
from trl_explore.numerics.compiled.arrays import borrow, lane, on_stack
from trl_explore.numerics.compiled.cache import compiled, kernel_function
from trl_explore.numerics.compiled.philox import STATE_SIZE, begin

INLINED = (memory_module, compiled_mixtures, compiled_policies, arrays, elementary, layers, philox)
"""The modules compiled into the loop, besides this one and the kernel's."""


def compile_loop(
    kernel: Kernel, network: Network, masked: bool = False, *, records: bool = True
) -> Callable[..., tuple[int, int]]:
    """The episode loop for a kernel and a policy; compiled on the first call, or read from disk.

    The function returned has the signature

        loop(parameters, trials, episodes, first_trial, env_key, action_key, weights, mixture,
             explore, memory, columns, score, length, done, place) -> (done, place)

    with

        trials, episodes   [m] int64, rows of the weights and numbers of their episodes
        weights            from ``compiled_policies.arrays``
        mixture            [4, 1 or *] float64: greedy, softmax, uniform, temperature
        explore            whether to draw actions; if not, the first action of largest logit
        memory             from ``memory.scratch``
        columns            ``columns.Columns.arrays``

    It runs the episodes from index ``done`` on, writes their frames from frame ``place`` on, and
    their outcomes to score [m] float64 and length [m] int64. It stops before a group of episodes
    that does not fit.

    Args:
        kernel: the environment.
        network: the policy.
        masked: whether to apply the kernel's action masks and write them to the columns.
        records: whether to write the frames; if not, ``columns`` and ``place`` are unused.
    """
    functions = (kernel.reset, kernel.step, kernel.observe, kernel.mask if masked else None)
    return _compile(*functions, kernel.state_size, network, kernel.digest, records)


@lru_cache(maxsize=32)
def _compile(  # noqa: C901 - the parts of one compiled function
    reset: Any,
    step: Any,
    observe: Any,
    mask: Any,
    state_size: int,
    network: Network,
    digest: str,
    records: bool,
) -> Callable[..., tuple[int, int]]:
    n_features, n_actions = network.sizes[0], network.sizes[-1]
    narrow = is_narrow(network, mask is not None)
    row = row_of if records else only_row_of
    x_of = _x_of_lane if narrow else _compile_x(n_features, row)
    record = 4 + n_features if narrow else 4
    n_masks = n_actions if mask is not None else 0
    deliver = compile_deliver(record, narrow, n_features, n_masks) if records else _no_delivery
    load, logits = compile_network(network)
    mix, draw, first_largest = compile_mixing(n_actions)
    legal = _nothing if mask is None else _compile_mask(mask, n_actions, row)
    f32, f64, u64 = nb.float32, nb.float64, nb.uint64
    state_lanes, rng_lanes = on_stack(f64, state_size, LANES), on_stack(u64, STATE_SIZE, LANES)
    noise_lanes, point_lanes = on_stack(f64, 4, LANES), on_stack(f32, 4, LANES)
    local_lanes = on_stack(f32, max(1, network.local), LANES)
    x_lanes = on_stack(f32, n_features if narrow else 1, LANES)
    probs_lanes, work_lanes = on_stack(f32, n_actions, LANES), on_stack(f32, n_actions, LANES)
    place_lanes, value_lanes = on_stack(nb.int64, 6, LANES), on_stack(f32, 3, LANES)
    score_lanes, over_lanes = on_stack(f64, LANES), on_stack(nb.boolean, LANES)

    @part
    def begin_episode(j, slot, row, max_steps, parameters, weights, mixture, scratch, lanes):
        """Reset the environment of lane j, whose stream has been set, and load its weights."""
        reset(parameters, lane(lanes.state, j), lane(lanes.rng, j))
        load(weights, row, lane(lanes.local, j), scratch.own, lanes.place[WEIGHT_SLOT, j])
        load_point(mixture, row if mixture.shape[1] > 1 else 0, lane(lanes.point, j))
        lanes.place[SLOT, j], lanes.place[ROW, j] = slot, row
        lanes.value[1, j], lanes.score[j] = 0, 0
        lanes.place[FRAME, j], lanes.place[END, j] = slot * max_steps, (slot + 1) * max_steps

    @part
    def act(t, left, parameters, weights, explore, scratch, lanes):
        """Observe and choose an action in every lane."""
        if narrow:
            for j in range(left):
                observe(parameters, lane(lanes.state, j), x_of(scratch, lanes, j))
        full = (left + 7) & ~7 if narrow else left  # whole vectors; surplus lanes are ignored
        for j in range(full):
            x, probs, local = x_of(scratch, lanes, j), lane(lanes.probs, j), lane(lanes.local, j)
            row, weight_slot = lanes.place[ROW, j], lanes.place[WEIGHT_SLOT, j]
            if not narrow:  # a long observation is read while it is in the cache
                observe(parameters, lane(lanes.state, j), x)
            logits(weights, row, local, scratch.own, weight_slot, scratch.hidden, x, probs)
            legal(parameters, lane(lanes.state, j), scratch, lanes, j, probs)
        if explore:
            for j in range(full):
                mix(lane(lanes.probs, j), lane(lanes.work, j), lane(lanes.point, j))
            for j in range(full):
                action, chance = draw(lane(lanes.probs, j), lanes.noise[t & 3, j])
                lanes.place[ACTION, j], lanes.value[2, j] = action, chance
        else:
            for j in range(left):
                action = first_largest(lane(lanes.probs, j))
                lanes.place[ACTION, j], lanes.value[2, j] = action, 1

    @part
    def advance(left, parameters, lanes):
        """Step every lane; returns the number of episodes that have ended."""
        count = 0
        for j in range(left):
            reward, terminal = step(
                parameters, lane(lanes.state, j), lanes.place[ACTION, j], lane(lanes.rng, j)
            )
            lanes.value[0, j] = reward
            lanes.value[1, j] += lanes.value[0, j]
            lanes.score[j] += reward
            lanes.over[j] = terminal
        for j in range(left):
            count += lanes.over[j] | (lanes.place[FRAME, j] + 1 == lanes.place[END, j])
        return count

    @part
    def keep(left, scratch, lanes):
        """Write the frame of every lane to the scratch of its episode."""
        if records:
            frames = borrow(scratch.frames)
            for j in range(left):
                start = lanes.place[FRAME, j] * record
                frame = frames[start : start + record]
                for k in range(3):
                    frame[k] = lanes.value[k, j]
                frame[3] = lanes.place[ACTION, j]  # float32 is exact up to 2^24
                for k in range(4, record):
                    frame[k] = lanes.x[k - 4, j]
        for j in range(left):
            lanes.place[FRAME, j] += 1

    def loop(
        parameters, trials, episodes, first_trial, env_key, action_key, weights, mixture,
        explore, memory, columns, score, length, done, place,
    ):  # fmt: skip
        arrays, width, max_steps = memory
        # Not passed as a named tuple: numba cannot read its cache after the class has moved.
        scratch = Scratch(*arrays)
        lanes = Lanes(
            state_lanes(), rng_lanes(), noise_lanes(), point_lanes(), local_lanes(), x_lanes(),
            probs_lanes(), work_lanes(), place_lanes(), value_lanes(), score_lanes(), over_lanes(),
        )  # fmt: skip
        clear(lanes)
        while done < len(trials):
            n = min(len(scratch.steps), len(trials) - done)
            group, numbers = trials[done : done + n], episodes[done : done + n]
            left = begun = t = 0
            while left > 0 or begun < n:
                if t & 3 == 0:
                    while left < width and begun < n:
                        row, episode = group[begun], np.uint64(numbers[begun])
                        begin(lane(lanes.rng, left), env_key, episode, np.uint64(first_trial + row))
                        begin_episode(
                            left, begun, row, max_steps, parameters, weights, mixture, scratch,
                            lanes,
                        )  # fmt: skip
                        left += 1
                        begun += 1
                    if records or explore:
                        draw_noise(left, max_steps, numbers, first_trial, action_key, lanes)
                act(t, left, parameters, weights, explore, scratch, lanes)
                count = advance(left, parameters, lanes)
                keep(left, scratch, lanes)
                if count > 0:
                    left = retire(left, max_steps, scratch, lanes)
                t += 1
            total = scratch.steps[:n].sum()
            if records and total > len(columns[0]) - place:
                return done, place
            for slot in range(n):
                deliver(scratch, columns, slot, max_steps, group[slot], place)
                score[done] = scratch.score[slot]
                length[done] = scratch.steps[slot]
                place += scratch.steps[slot]
                done += 1
        return done, place

    return compiled(*INLINED, key=(state_size, network, mask is not None, digest, records))(loop)


@part
def _x_of_lane(scratch, lanes, j):
    """The place of a narrow observation."""
    return lane(lanes.x, j)


def _compile_x(n_features: int, row: Any) -> Any:
    """The function that gives the place of lane j's observation if it is not narrow."""

    @part
    def x_in_scratch(scratch, lanes, j):
        return row(scratch.observation, lanes, j, n_features)

    return x_in_scratch


def _compile_mask(mask: Any, n_actions: int, row: Any) -> Any:
    """The function that sets the logits of illegal actions to −∞."""

    @kernel_function
    def legal(parameters, state, scratch, lanes, j, logits):
        allowed = row(scratch.allowed, lanes, j, n_actions)
        mask(parameters, state, allowed)
        for a in range(n_actions):
            logits[a] = logits[a] if allowed[a] else -np.inf

    return legal


@kernel_function
def _no_delivery(scratch, columns, slot, max_steps, row, start):
    """No frames are kept."""


@kernel_function
def _nothing(parameters, state, scratch, lanes, j, logits):
    """All actions are legal."""
