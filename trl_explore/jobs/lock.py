"""A lock that allows one process at a time in a folder."""

from __future__ import annotations

import os
import time
from pathlib import Path
from types import TracebackType

try:
    import fcntl
except ModuleNotFoundError:
    fcntl = None  # on Windows, where results can be read, but nothing can be trained

NAME = ".lock"
PATIENCE = 0.2
"""Seconds to retry a lock; ``is_locked`` holds it only for microseconds."""


class LockedError(OSError):
    """Another process holds the lock of the folder; the message is one line."""


class Lock:
    """Hold a folder for this process until the lock is released or the process ends.

    An advisory lock (flock) on the file ``.lock`` in the folder. The kernel releases it when the
    process dies, so that a kill needs no clean-up. Releasing the lock deletes the file, and the
    folder if it is empty. A process that opened the file just before then locks a deleted file, or
    finds no folder to create the file in; it detects this and tries again.

    Args:
        folder: the folder; created if it does not exist.

    Raises:
        LockedError: if another process holds the lock.
        OSError: if the folder cannot be written to.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.path = folder, folder / NAME
        self._file = -1

    def __enter__(self) -> Lock:
        if fcntl is None:
            raise OSError("training needs the file locks of Linux or macOS; on Windows, use WSL")
        deadline = time.monotonic() + PATIENCE
        while self._file < 0:
            self.folder.mkdir(parents=True, exist_ok=True)
            try:
                file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            except FileNotFoundError:  # another process has just removed the empty folder
                if time.monotonic() > deadline:
                    raise
                continue
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if self._is_named(file):
                    self._file = file
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise LockedError(
                        f"{self.folder} is in use: another process runs this job"
                    ) from None
                time.sleep(PATIENCE / 10)
            finally:
                if self._file != file:
                    os.close(file)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.release()

    def release(self) -> None:
        """Release the lock, and remove the folder if it is empty."""
        if self._file < 0:
            return
        file, self._file = self._file, -1
        try:
            self.path.unlink(missing_ok=True)
            self.folder.rmdir()
        except OSError:
            pass  # usually not empty; or no longer writable
        finally:
            os.close(file)

    def _is_named(self, file: int) -> bool:
        """Whether the open file is still the one at ``path``."""
        try:
            return os.path.samestat(os.fstat(file), self.path.stat())
        except FileNotFoundError:
            return False


def is_locked(folder: Path) -> bool:
    """Whether a process runs the job of this folder; changes nothing."""
    if fcntl is None:
        return False
    try:
        file = os.open(folder / NAME, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(file)
    return False
