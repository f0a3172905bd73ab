"""When to save the checkpoints of a job, and how to resume from them."""

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
    from trl_explore.training.shards import Shards
    from trl_explore.training.trainer import Trainer
    from trl_explore.training.trials import Trials

SHARE = 0.01
"""Maximum share of the time spent on checkpoints (approximate), however slow the disk is."""
SLOW = 0.2
"""Iterations longer than this [s] keep the state before them, in case they are interrupted."""

logger = logging.getLogger(__name__)


class Saver:
    """Saves checkpoints of a shard between iterations; called as ``trainer.on_iteration``.

    If a checkpoint cannot be written (full disk, no permission), training continues: one line
    reports it, and the next checkpoint is saved when it is due.

    Args:
        store: the checkpoint files.
        trainer: the trainer whose state is saved.
        header: facts about the job needed before its state is loaded, as JSON.
        interrupts: the signals of the job.
        seconds: the time between two checkpoints; 0: save after every iteration.
        final: whether to save a checkpoint when all trials have stopped.
        elapsed: returns the seconds of training of the job so far; None: those of the trainer.

    Raises:
        TypeError: if a part of the trainer has a state that cannot be saved.
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
        """After an iteration, save a checkpoint if one is due, and stop if a signal was received.

        Raises:
            Interrupted: if a signal was received.
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
        """After an interrupted iteration, save the state before it, if it was kept.

        Nothing is saved afterwards: a thread may still be running that iteration.
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
                if self.store.lost():
                    self.store.clear()
                    self.saved = 0
                history = self.trainer.history(self.saved, iteration)
                self.store.save({**self.header, **progress}, state, history)
                self.saved = iteration
            except OSError as error:
                if not self._complained:
                    self._complained = True
                    logger.warning(
                        "cannot write a checkpoint (%s): %s", error.strerror, self.store.folder
                    )
        ended = time.monotonic()
        pause = (ended - started) / SHARE if self.seconds else 0
        self._due = ended + max(self.seconds, pause)


def restore(trainer: Trainer, checkpoint: Checkpoint) -> None:
    """Restore a new trainer to the state of the checkpoint.

    Raises:
        ValueError: if the checkpoint belongs to another trainer.
    """
    try:
        for part in checkpoint.history:
            trainer.load_history(part)
        trainer.load_state_dict(unpack(checkpoint.state))
    except (KeyError, TypeError, RuntimeError, IndexError, AttributeError) as error:
        text = " ".join(str(error).split())
        raise ValueError(
            f"the checkpoint does not fit this program ({text}); restart=true starts over"
        ) from error


class Checkpoints:
    """The checkpoints of a job, one for each shard.

    Args:
        job: the folder of the job.
        load: whether to load existing checkpoints; a damaged one gives a warning.

    Attributes:
        header: the header of a checkpoint; None: there are no checkpoints.
        savers: one for each shard, after ``attach``.
    """

    def __init__(self, job: Path, *, load: bool = True) -> None:
        self.folder, self.savers = job / FOLDER, list[Saver]()
        self._job, self._found = job, dict[int, tuple[Store, Checkpoint]]()
        names = [path.name for path in self.folder.glob("*")] if load else []
        for k in sorted(int(name) for name in names if name.isdecimal()):
            store = Store(job, k)
            checkpoint, damaged = store.load()
            if checkpoint is not None:
                self._found[k] = store, checkpoint
            if damaged:
                what = "resuming from the previous one" if checkpoint else "its trials start over"
                logger.warning("damaged checkpoint, %s: %s", what, "; ".join(damaged))
        headers = [checkpoint.header for _, checkpoint in self._found.values()]
        self.header = headers[0] if headers else None
        self._seconds = max((float(header["seconds"]) for header in headers), default=0.0)

    @property
    def sizes(self) -> list[int] | None:
        """The sizes of the shards; None if there are no checkpoints."""
        return None if self.header is None else self.header["shards"]

    def attach(
        self, shards: Shards, header: Mapping[str, Any], interrupts: Interrupts, seconds: float
    ) -> None:
        """Restore every shard from its checkpoint, and prepare to save the next ones.

        Args:
            shards: the shards, before they run.
            header: facts about the job needed before its state is loaded, as JSON.
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
        """After an interruption, save the states that the savers kept."""
        for saver in self.savers:
            saver.rescue()

    @property
    def where(self) -> str:
        """The iteration from which training resumes, in words."""
        saved = [saver.saved for saver in self.savers]
        if len(saved) < 2:
            return f"iteration {saved[0]}" if any(saved) else ""
        return f"iterations {min(saved)} to {max(saved)}" if any(saved) else ""

    def clear(self) -> None:
        """Remove all checkpoints."""
        for folder in self.folder.glob("*"):
            if folder.name.isdecimal():
                Store(self._job, int(folder.name)).clear()
        shutil.rmtree(self.folder, ignore_errors=True)
