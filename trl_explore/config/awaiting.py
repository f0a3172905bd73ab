"""Waiting for every job of a sweep that runs on a cluster, however each of them ends.

The launchers of submitit and Ray stop waiting at the first job that the cluster has ended:
cancelled, out of memory, on a node that died. The program would end while other jobs still run.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import Any

from hydra.core.utils import JobReturn, JobStatus

from trl_explore.checks import first_line

OVER = {
    "BOOT_FAIL", "CANCELLED", "COMPLETED", "DEADLINE", "FAILED", "NODE_FAIL", "OUT_OF_MEMORY",
    "TIMEOUT",
}  # fmt: skip
"""The states of Slurm from which a job does not return by itself."""
GONE = "no longer in the queue"
POLL = 60
"""The longest time between two looks at Slurm's queue [s]."""


def await_all(launcher: str, end: Callable[[str], None]) -> None:
    """Make a launcher wait for all its jobs; other launchers than submitit and Ray stay as is.

    Args:
        launcher: the full name of the launcher's class.
        end: called once per job, in the order of the jobs, with one line that says how the
            cluster ended the job, or with an empty text if the job ended by itself.
    """
    if ".hydra_submitit_launcher." in launcher:
        _await_submitit(end)
    elif ".hydra_ray_launcher." in launcher:
        _await_ray(end)


def _ended() -> JobReturn:
    """What the launcher returns for a job whose outcome is read from its files."""
    returned = JobReturn(status=JobStatus.COMPLETED)
    returned.return_value = None
    return returned


def _await_ray(end: Callable[[str], None]) -> None:
    ray = import_module("ray")  # by name: it is in no environment that the type checker sees
    core = import_module("hydra_plugins.hydra_ray_launcher._core")

    class Ray:
        @staticmethod
        def get(run: Any) -> Any:
            try:
                returned = ray.get(run)
            except ray.exceptions.RayError as error:
                end(f"Ray ended the job ({type(error).__name__})")
                return _ended()
            end("")
            return returned

    vars(core)["ray"] = Ray  # the launcher calls ray.get for one job after the other


def _await_submitit(end: Callable[[str], None]) -> None:
    from submitit import AutoExecutor
    from submitit.slurm.slurm import SlurmJob

    logging.getLogger("submitit").setLevel(logging.ERROR)
    SlurmJob.watcher = _queue()
    start = getattr(AutoExecutor.map_array, "__wrapped__", AutoExecutor.map_array)

    @wraps(start)
    def map_array(executor: Any, *arguments: Any) -> list[_Awaited]:
        return [_Awaited(job, end) for job in start(executor, *arguments)]

    AutoExecutor.map_array = map_array  # pyright: ignore[reportAttributeAccessIssue]


class _Awaited:
    """A job of submitit whose ``results`` waits, and never raises an exception."""

    def __init__(self, job: Any, end: Callable[[str], None]) -> None:
        self.job, self.end = job, end

    def results(self) -> list[Any]:
        self.job.wait()
        if not self.job.paths.result_pickle.exists() and self.job.state != "COMPLETED":
            self.end(f"the job ended without a result ({self.job.state})")
        elif (error := self.job.exception()) is not None:
            self.end(_last_line(error))
        else:
            self.end("")
            return self.job.results()
        return [_ended()]


def _last_line(error: Exception) -> str:
    """The last line of the traceback in a message of submitit, or else its first line."""
    _, *traceback = str(error).split(f"\n{'-' * 22}\n")
    return traceback[0].strip().splitlines()[-1] if traceback else first_line(error)


def _queue() -> Any:
    """The states of Slurm's jobs, from ``squeue``: unlike ``sacct``, it needs no database."""
    from submitit.slurm.slurm import SlurmInfoWatcher

    class Queue(SlurmInfoWatcher):
        def _make_command(self) -> list[str] | None:
            if not self._registered - self._finished:
                return None
            user = f"--user={os.getuid()}"
            return ["squeue", user, "--array", "--noheader", "--states=all", "--format=%i|%T"]

        def read_info(self, string: bytes | str) -> dict[str, dict[str, str]]:
            text = string if isinstance(string, str) else string.decode()
            states = dict(line.split("|", 1) for line in text.split())
            known = {job: states.get(job, GONE) for job in self._registered}
            return {
                job: {"State": state if state in OVER or state == GONE else "RUNNING"}
                for job, state in known.items()
            }

    return Queue(delay_s=POLL)
