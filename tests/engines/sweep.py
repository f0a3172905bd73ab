"""The sweep that the tests of Ray and Slurm run: serially, and on the cluster."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "commands")]  # not an installed older version
from test_launchers import payload  # noqa: E402

PATIENCE = 900
"""Seconds to wait for an event on a very busy machine."""
WORDS = [
    "-m", "experiment=debug", "env=gym", "env.id=waiting:Waiting-v0", "trials=2",
    "score_threshold=99", "checkpoint_seconds=0.2",
]  # fmt: skip
SLOW, FAST = "0.05", "0"


def skip(reason: str) -> NoReturn:
    """End the test, and say why it does not run here."""
    print(f"skipped: {reason}")
    raise SystemExit(0)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A new folder, removed at the end, also if this process is terminated."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that daemons are ended
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


class Sweep:
    """One sweep in two folders of ``place``: run serially, and by a launcher."""

    def __init__(self, place: Path, lengths: list[int]) -> None:
        self.place, self.lengths, self.wait = place, lengths, place / "wait"
        self.environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(HERE)])}
        self.serial, self.cluster = place / "serial" / "debug", place / "cluster" / "debug"
        self.log = place / "command.log"
        assert self.start().wait() == 0, self.said()
        self.environment["TRL_EXPLORE_WAIT"] = str(self.wait)

    def start(self, *words: str) -> subprocess.Popen[bytes]:
        """Start the command in the folder of ``cluster``, or of ``serial`` without words."""
        folder = (self.cluster if words else self.serial).parent
        with self.log.open("wb") as file:
            return subprocess.Popen(
                [sys.executable, str(ROOT / "scripts" / "train.py"), *WORDS,
                 f"max_iterations={','.join(map(str, self.lengths))}",
                 f"output_dir={folder.name}", *words],
                cwd=self.place, env=self.environment, stdout=file, stderr=subprocess.STDOUT,
            )  # fmt: skip

    def said(self) -> str:
        """What the last command printed."""
        return self.log.read_text(errors="replace")

    def pace(self, seconds: str) -> None:
        """How long a step takes from now on, in every job."""
        new = self.wait.with_suffix(".new")
        new.write_text(seconds)
        new.replace(self.wait)

    def job(self, length: int, folder: Path | None = None) -> Path:
        """The folder of the job with this ``max_iterations``."""
        of = {job.name for job in self.serial.iterdir() if f"max_iterations={length}," in job.name}
        return (folder or self.cluster) / of.pop()

    def has_begun(self, length: int) -> bool:
        """Whether the job has saved a checkpoint."""
        return any(self.job(length).glob("checkpoint/*"))

    def is_done(self, length: int) -> bool:
        """Whether the job is finished."""
        return (self.job(length) / "run.json").is_file()

    def check_files(self) -> None:
        """Every file of every job equals that of the serial sweep, but for wall-clock times."""
        for length in self.lengths:
            one, other = self.job(length, self.serial), self.job(length)
            assert payload(other) == payload(one), f"the files of {one.name} differ"
        for name in ("sweep.json", ".failed"):
            assert not (self.cluster / name).exists(), f"{name} is left"


def until(what: str, holds: Callable[[], object], process: subprocess.Popen | None = None) -> None:
    """Wait until ``holds()``; fail if ``process`` ends before."""
    print(f"  until {what}", flush=True)
    deadline = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < deadline, f"not within {PATIENCE} s: {what}"
        assert process is None or process.poll() is None, f"the command ended before {what}"
        time.sleep(0.3)
