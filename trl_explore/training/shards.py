"""The trials of a job in shards, each trained from first episode to last by one thread.

Trials are independent: the results of a trial do not depend on the other trials in its shard. So
shards do not communicate, and their results are joined once, at the end. Every file of a job is
the same for any partition and any number of threads.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from trl_explore.numerics.compiled.cache import clock
from trl_explore.training.snapshots import Snapshots, Visits
from trl_explore.training.trainer import Trainer
from trl_explore.training.trials import Trials

LARGEST = 4096
"""Most trials in a shard: larger ones need more memory for the frames and are not faster."""
SMALLEST = 500
"""Fewest trials in a shard of several: the Python part of an iteration does not parallelise."""
LOOK = 0.1
"""Seconds between two checks of the main thread for signals."""


def partition(trials: int, threads: int = 1) -> list[int]:
    """The sizes of the shards of a job.

    Example:
        >>> partition(300), partition(1500, threads=2), partition(300, threads=2)
        ([300], [750, 750], [300])
        >>> partition(5000)
        [2500, 2500]
    """
    count = max(1, -(-trials // LARGEST), min(threads, trials // SMALLEST))
    if count >= threads:
        count = threads * -(-count // threads)  # all threads have work until the end
    edges = [trials * k // count for k in range(count + 1)]
    return [high - low for low, high in pairwise(edges)]


class Shards:
    """Trains the shards of a job and joins their results.

    Args:
        trainers: one per shard, in the order of the trials.

    Attributes:
        offsets: the number of trials before each shard.
    """

    def __init__(self, trainers: Sequence[Trainer]) -> None:
        self.trainers = list(trainers)
        self.offsets = [0, *accumulate(len(trainer.trials) for trainer in trainers)][:-1]
        self._before, self._started = 0.0, None

    @property
    def seconds(self) -> float:
        """Wall time of training so far, without compilation [s]."""
        return self._before + (0.0 if self._started is None else clock() - self._started)

    def resume(self, seconds: float) -> None:
        """Start counting from the seconds of an interrupted training."""
        self._before = seconds

    def run(self, threads: int = 1) -> Trials:
        """Train until every trial has stopped; returns the record of all trials.

        An exception in one shard stops the others at their next iteration, and is raised here.
        """
        self._started = clock()
        try:
            threads = min(threads, len(self.trainers))
            if threads > 1:
                self._run_threads(threads)
            else:
                for trainer in self.trainers:
                    trainer.run()
                    trainer.close()
        finally:
            self._before, self._started = self.seconds, None
        return self.trials()

    def _run_threads(self, threads: int) -> None:
        todo, errors = iter(self.trainers), list[BaseException]()
        failed, ended = threading.Event(), threading.Semaphore(0)

        def work() -> None:
            try:
                for trainer in todo:
                    trainer.run(failed.is_set)
                    trainer.close()
            except BaseException as error:
                errors.append(error)
                if not isinstance(error, KeyboardInterrupt):  # a signal stops every shard anyway
                    failed.set()
            finally:
                ended.release()

        try:
            for _ in range(threads):
                threading.Thread(target=work, daemon=True).start()
            for _ in range(threads):
                while not ended.acquire(timeout=LOOK):  # signals are handled in between
                    pass
        finally:
            failed.set()
        if errors:
            raise errors[0]

    def trials(self) -> Trials:
        """The record of all trials."""
        return Trials.joined([trainer.trials for trainer in self.trainers])

    def weights(self) -> Mapping[str, Tensor]:
        """The parameters of the policy [trials, ...] by name."""
        parts = [dict(trainer.collector.policy[0].named_parameters()) for trainer in self.trainers]
        if len(parts) == 1:
            return parts[0]
        return {name: torch.cat([part[name].detach() for part in parts]) for name in parts[0]}

    def recorded(self) -> dict[str, Any]:
        """What was recorded beside trials and weights, by argument of ``jobs.write_job``."""
        return {
            "kept": self.kept_weights(),
            "evaluations": self.evaluations(),
            "learned": self.learned(),
            "diagnostics": self.diagnostics(),
            "visits": self.visits(),
        }

    def kept_weights(self) -> dict[str, NDArray[Any]] | None:
        """The weights along the way (``Snapshots.joined``); None if none were asked for."""
        found = [t.snapshots for t in self.trainers if t.snapshots is not None]
        return Snapshots.joined(found)

    def evaluations(self) -> dict[str, NDArray[Any]] | None:
        """The rows of ``Evaluator.rows`` for all trials; None if there is no evaluation."""
        parts = [t.evaluator.rows() for t in self.trainers if t.evaluator is not None]
        if not parts:
            return None
        for part, offset in zip(parts, self.offsets, strict=False):
            part["trial"] = part["trial"] + offset
        rows = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        order = np.lexsort((rows["trial"], rows["purpose"], rows["iteration"]))
        return {name: column[order] for name, column in rows.items()}

    def learned(self) -> dict[str, NDArray[Any]] | None:
        """What every trial has learned, by column of ``trials.csv``; None: not evaluated."""
        found = [t.evaluator for t in self.trainers if t.evaluator is not None]
        names = ("learned", "iterations_to_learn", "frames_to_learn", "learned_score")
        if not found:
            return None
        return {name: np.concatenate([getattr(part, name) for part in found]) for name in names}

    def diagnostics(self) -> dict[str, NDArray[Any]] | None:
        """Every diagnostic, one entry per iteration and active trial; None if not recorded."""
        found = [t.diagnostics for t in self.trainers if t.diagnostics is not None]
        if not found:
            return None
        order = np.argsort(np.concatenate([d.iterations() for d in found]), kind="stable")
        parts = [d.columns() for d in found]
        return {name: np.concatenate([part[name] for part in parts])[order] for name in parts[0]}

    def visits(self) -> dict[str, NDArray[np.int64]] | None:
        """Where all trials have been (``Visits.joined``); None if not recorded."""
        found = [t.diagnostics.visits for t in self.trainers if t.diagnostics is not None]
        return Visits.joined([visits for visits in found if visits is not None])

    def close(self) -> None:
        """Close the environments."""
        for trainer in self.trainers:
            trainer.close()
