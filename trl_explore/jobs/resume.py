"""When a job's checkpoints are taken, and how it goes on from one."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trl_explore.jobs.checkpoint import Checkpoint, Packed, Store, pack, unpack
from trl_explore.jobs.signals import Interrupts

if TYPE_CHECKING:
    from trl_explore.training.record import Trials
    from trl_explore.training.trainer import Trainer

SHARE = 0.01
"""Checkpoints take at most about this share of the time, however slow the disk is."""
SLOW = 0.2
"""Seconds of an iteration from which the state before it is kept, should it be broken off."""

logger = logging.getLogger(__name__)


class Saver:
    """Takes checkpoints at the boundaries of iterations: ``trainer.on_iteration``.

    A checkpoint that cannot be written (a full disk, a folder without permission) does not end the
    training: one line says so, and the next one is tried in its turn.

    Args:
        store: where they go.
        trainer: whose state.
        header: what is to be known of the job before its state is loaded, as JSON.
        interrupts: the signals of the job.
        seconds: the time between two checkpoints; 0 takes one after every iteration.

    Raises:
        TypeError: if a part of the trainer has a state that cannot be written.
    """

    def __init__(
        self,
        store: Store,
        trainer: Trainer,
        header: Mapping[str, Any],
        interrupts: Interrupts,
        *,
        seconds: float,
    ) -> None:
        self.store, self.trainer, self.header = store, trainer, dict(header)
        self.interrupts, self.seconds = interrupts, seconds
        self.saved = trainer.trials.iteration
        """The iteration of the last checkpoint."""
        self._complained = False
        self._kept: tuple[int, Packed] | None = None
        pack(trainer.state_dict())
        self._last = time.monotonic()
        self._due = self._last + seconds

    def __call__(self, trials: Trials) -> None:
        """After an iteration: a checkpoint if it is time to, and the end if a signal has come.

        Raises:
            Interrupted: if a signal has come.
        """
        self._kept = None
        if self.interrupts.pending is not None:
            if trials.iteration > self.saved:
                self._save(trials.iteration, pack(self.trainer.state_dict()))
            self.interrupts.check()
        now = time.monotonic()
        if now >= self._due:
            self._save(trials.iteration, pack(self.trainer.state_dict()))
        elif now - self._last > SLOW:
            self._kept = trials.iteration, pack(self.trainer.state_dict())
        self._last = time.monotonic()

    def rescue(self) -> None:
        """After an iteration was broken off: write the state before it, if it was kept."""
        if self._kept is not None:
            self._save(*self._kept)

    def _save(self, iteration: int, state: Packed) -> None:
        started = time.monotonic()
        progress = {"iteration": iteration, "seconds": self.trainer.seconds}
        with self.interrupts.held():
            try:
                history = self.trainer.history(self.saved, iteration)
                self.store.save({**self.header, **progress}, state, history)
                self.saved = iteration
            except OSError as error:
                if not self._complained:
                    self._complained = True
                    logger.warning(
                        "no checkpoint can be written (%s): %s", error.strerror, self.store.folder
                    )
        ended = time.monotonic()
        pause = (ended - started) / SHARE if self.seconds else 0
        self._due = ended + max(self.seconds, pause)


def restore(trainer: Trainer, checkpoint: Checkpoint) -> None:
    """Put a trainer that has not run where the checkpoint was taken.

    Raises:
        ValueError: if the checkpoint is of another trainer.
    """
    try:
        for part in checkpoint.history:
            trainer.load_history(part)
        trainer.load_state_dict(unpack(checkpoint.state))
    except (KeyError, TypeError, RuntimeError, IndexError, AttributeError) as error:
        text = " ".join(str(error).split())
        raise ValueError(f"its checkpoint is not of this program ({text})") from error


def find(job: Path) -> tuple[Store, Checkpoint | None]:
    """The checkpoints of a job; one line of warning if one of them is damaged."""
    store = Store(job)
    checkpoint, damaged = store.load()
    if damaged:
        what = "going on from the one before" if checkpoint else "the job begins anew"
        logger.warning("damaged checkpoint, %s: %s", what, "; ".join(damaged))
    return store, checkpoint
