"""How compiled code of one thread calls another thread, without the interpreter and its lock.

A thread that sleeps takes tens of microseconds to wake up, as long as a thousand frames last, and
one that wants the interpreter's lock while others hold it sleeps. So a thread that soon has work
again waits in compiled code, looking at a cell of memory, which is written by compiled code.
"""

# numba rewrites signatures:
# pyright: reportCallIssue=false

from __future__ import annotations

import time
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from trl_explore.numerics.compiled import arrays
from trl_explore.numerics.compiled.arrays import on_stack
from trl_explore.numerics.compiled.cache import compiled, kernel_function

LINE = 8
"""Cells of a cache line: what two threads write lies in lines of its own."""
CALLED, NUMBER, REPORTED = 0, LINE, 2 * LINE
"""The cells of one worker: the last call that it has been told of, the last one that there is for
it, and the last one that it has finished."""
CELLS = 3 * LINE
LOOKS = 1000
"""How often a thread looks before it lets others have the core."""


def cells(workers: int) -> NDArray[np.int64]:
    """The memory of a bell: a line with the number of workers to call, and then their cells."""
    return np.zeros(LINE + workers * CELLS, dtype=np.int64)


@intrinsic
def _load(typingctx: Any, address: Any) -> Any:
    """The cell at an address, and everything that was written before it was."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        cell = builder.inttoptr(args[0], ir.IntType(64).as_pointer())
        return builder.load_atomic(cell, "acquire", 8)

    return types.int64(types.int64), codegen


@intrinsic
def _store(typingctx: Any, address: Any, value: Any) -> Any:
    """Write the cell at an address, after everything that was written before."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        cell = builder.inttoptr(args[0], ir.IntType(64).as_pointer())
        builder.store_atomic(args[1], cell, "release", 8)
        return context.get_dummy_value()

    return types.none(types.int64, types.int64), codegen


_yield = types.ExternalFunction("sched_yield", types.int32())
"""Leave the core to other threads that could run on it, if there are any."""
_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.intp))
_timespec = on_stack(types.int64, 2)
_CLOCK = time.CLOCK_MONOTONIC


@kernel_function
def _nanoseconds(timespec):
    """The time by a clock that only goes forward."""
    _gettime(_CLOCK, timespec.ctypes.data)
    return timespec[0] * 1_000_000_000 + timespec[1]


@kernel_function
def ring(bell):
    """Call the workers that the cells at address ``bell`` say; 0: there are none.

    To be called by compiled code that has left the interpreter's lock to them.
    """
    if bell != 0:
        for i in range(_load(bell)):
            worker = bell + 8 * (LINE + i * CELLS)
            _store(worker + 8 * CALLED, _load(worker + 8 * NUMBER))


@compiled(arrays)
def heard(cell, last, patience):
    """Wait until the cell at an address is larger than ``last``; whether that took not too long.

    Args:
        cell: the address.
        last: a number.
        patience: for how long to wait, if nobody else wants the core [ns].
    """
    timespec = _timespec()
    begun = _nanoseconds(timespec)
    while True:
        for _ in range(LOOKS):
            if _load(cell) > last:
                return True
        if _nanoseconds(timespec) - begun > patience:
            return False
        _yield()


@compiled(arrays)
def report(cell, number, next_cell, patience):
    """Write a number to the cell at an address, and wait for a larger one in another cell."""
    _store(cell, number)
    return heard(next_cell, number, patience)
