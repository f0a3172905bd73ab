"""When a job's checkpoints are taken, and how it goes on from one."""

from __future__ import annotations

import logging
import shutil
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trl_explore.jobs.checkpoint import FOLDER, Checkpoint, Packed, Store, pack, unpack
from trl_explore.jobs.signals import Interrupts

if TYPE_CHECKING:
    from trl_explore.training.record import Trials
    from trl_explore.training.shards import Shards
    from trl_explore.training.trainer import Trainer

SHARE = 0.01
"""Checkpoints take at most about this share of the time, however slow the disk is."""
SLOW = 0.2
"""Seconds of an iteration from which the state before it is kept, should it be broken off."""

logger = logging.getLogger(__name__)


class Saver:
    """Takes checkpoints of a shard at the boundaries of iterations: ``trainer.on_iteration``.

    A checkpoint that cannot be written (a full disk, a folder without permission) does not end the
    training: one line says so, and the next one is tried in its turn.

    Args:
        store: where they go.
        trainer: whose state.
        header: what is to be known of the job before its state is loaded, as JSON.
        interrupts: the signals of the job.
        seconds: the time between two checkpoints; 0 takes one after every iteration.
        final: whether a checkpoint is taken when all trials have stopped.
        elapsed: the seconds of the job's training so far; None: those of the trainer.

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
        final: bool = False,
        elapsed: Callable[[], float] | None = None,
    ) -> None:
        self.store, self.trainer, self.header = store, trainer, dict(header)
        self.interrupts, self.seconds, self.final = interrupts, seconds, final
        self.elapsed = elapsed or (lambda: trainer.seconds)
        self.saved = trainer.trials.iteration
        """The iteration of the last checkpoint."""
        self._lock = threading.Lock()
        self._closed = False
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
        with self._lock:
            self._kept = None
            if self.interrupts.pending is not None:
                if trials.iteration > self.saved:
                    self._save(trials.iteration, pack(self.trainer.state_dict()))
                self.interrupts.check()
            now = time.monotonic()
            if now >= self._due or (self.final and not trials.active.any()):
                self._save(trials.iteration, pack(self.trainer.state_dict()))
            elif now - self._last > SLOW:
                self._kept = trials.iteration, pack(self.trainer.state_dict())
            self._last = time.monotonic()

    def rescue(self) -> None:
        """After an iteration was broken off: write the state before it, if it was kept.

        Nothing is written from here on: a thread may still be busy with that iteration.
        """
        with self._lock:
            if self._kept is not None:
                self._save(*self._kept)
            self._closed = True

    def _save(self, iteration: int, state: Packed) -> None:
        if self._closed:
            return
        started = time.monotonic()
        progress = {"iteration": iteration, "seconds": self.elapsed()}
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


class Checkpoints:
    """The checkpoints of a job, one for each of its shards.

    Args:
        job: the folder of the job.
        load: whether to look for checkpoints; one line of warning if one of them is damaged.

    Attributes:
        header: what one of them says of the job; None: there are none.
        savers: what takes them, once the training has been given to ``attach``.
    """

    def __init__(self, job: Path, *, load: bool = True) -> None:
        self.folder, self.savers = job / FOLDER, list[Saver]()
        self._job, self._found = job, dict[int, tuple[Store, Checkpoint]]()
        names = [path.name for path in self.folder.glob("*") if path.name.isdigit()] if load else []
        for k in sorted(map(int, names)):
            store = Store(job, k)
            checkpoint, damaged = store.load()
            if checkpoint is not None:
                self._found[k] = store, checkpoint
            if damaged:
                what = "going on from the one before" if checkpoint else "its trials begin anew"
                logger.warning("damaged checkpoint, %s: %s", what, "; ".join(damaged))
        headers = [checkpoint.header for _, checkpoint in self._found.values()]
        self.header = headers[0] if headers else None
        self._seconds = max((float(header["seconds"]) for header in headers), default=0.0)

    @property
    def sizes(self) -> list[int] | None:
        """The sizes of the shards; None: there are no checkpoints."""
        return None if self.header is None else self.header["shards"]

    def attach(
        self, shards: Shards, header: Mapping[str, Any], interrupts: Interrupts, seconds: float
    ) -> None:
        """Put every shard where its checkpoint was taken, and take the next ones.

        Args:
            shards: the training, which has not run.
            header: what is to be known of the job before its state is loaded, as JSON.
            interrupts: the signals of the job.
            seconds: the time between two checkpoints of a shard.
        """
        header = {**header, "shards": [len(trainer.trials) for trainer in shards.trainers]}
        shards.resume(self._seconds)
        for k, trainer in enumerate(shards.trainers):
            store, checkpoint = self._found.pop(k, (Store(self._job, k), None))
            if checkpoint is not None:
                restore(trainer, checkpoint)
            saver = Saver(
                store, trainer, header, interrupts, seconds=seconds,
                final=len(shards.trainers) > 1, elapsed=lambda: shards.seconds,
            )  # fmt: skip
            self.savers.append(saver)
            if checkpoint is None:
                store.clear()

    def rescue(self) -> None:
        """After the training was broken off: write what iterations began with, and no more."""
        for saver in self.savers:
            saver.rescue()

    @property
    def where(self) -> str:
        """Where the training goes on."""
        saved = [saver.saved for saver in self.savers]
        if len(saved) < 2:
            return f"iteration {saved[0]}" if any(saved) else ""
        return f"iterations {min(saved)} to {max(saved)}" if any(saved) else ""

    def clear(self) -> None:
        """Remove all checkpoints."""
        for folder in self.folder.glob("*"):
            if folder.name.isdigit():
                Store(self._job, int(folder.name)).clear()
        shutil.rmtree(self.folder, ignore_errors=True)
