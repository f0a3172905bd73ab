"""Where runs of frames end: those of one trial, those of one episode.

Eight frames are looked at in one step. Places are unsigned: numba takes a signed place, which could
be negative, for one that may count from the end, and what that costs keeps a loop from vectors.
"""

from __future__ import annotations

import numpy as np

from trl_explore.envs.kernels.kernel import kernel_function

_ONE, _STRIDE = np.uint64(1), np.uint64(8)


@kernel_function
def end_of_run(trial, start):
    """The first place behind ``start`` where another trial begins."""
    place, stop, lane = np.uint64(start) + _ONE, np.uint64(len(trial)), trial[start]
    while place + _STRIDE <= stop:
        change = trial[place] ^ lane
        for j in range(1, 8):
            change |= trial[place + np.uint64(j)] ^ lane
        if change != 0:
            break
        place += _STRIDE
    while place < stop and trial[place] == lane:
        place += _ONE
    return np.int64(place)


@kernel_function
def end_of_episode(done, start, stop):
    """The first place behind a frame that is done, at or behind ``start``; at most ``stop``."""
    place, last = np.uint64(start), np.uint64(stop)
    while place + _STRIDE <= last:
        ended = done[place]
        for j in range(1, 8):
            ended |= done[place + np.uint64(j)]
        if ended:
            break
        place += _STRIDE
    while place < last:
        place += _ONE
        if done[place - _ONE]:
            break
    return np.int64(place)
