"""One process at a time in a folder."""

from __future__ import annotations

import fcntl
import os
import time
from pathlib import Path
from types import TracebackType

NAME = ".lock"
PATIENCE = 0.2
"""Seconds for which a lock is tried; who only asks (``is_locked``) has it for microseconds."""


class LockedError(OSError):
    """The folder is another process's; the message is one line."""


class Lock:
    """The folder belongs to this process until it is released, or the process ends, however.

    An advisory lock (flock) on the file ``.lock`` in the folder. The kernel gives it back when its
    holder dies, so that nothing has to be tidied up after a kill. The file goes when the lock is
    released, and the folder if it is empty: whoever opened it just before then holds the lock of a
    file without a name, or has no folder to make one in, notices, and tries again.

    Args:
        folder: the folder, which is made if it does not exist.

    Raises:
        LockedError: if another process has it.
        OSError: if the folder cannot be written to.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.path = folder, folder / NAME
        self._file = -1

    def __enter__(self) -> Lock:
        deadline = time.monotonic() + PATIENCE
        while self._file < 0:
            self.folder.mkdir(parents=True, exist_ok=True)
            try:
                file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            except FileNotFoundError:  # who had it just took the empty folder away
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
        """Give the folder back, and remove it if nothing is in it."""
        if self._file < 0:
            return
        file, self._file = self._file, -1
        try:
            self.path.unlink(missing_ok=True)
            self.folder.rmdir()
        except OSError:
            pass  # not empty, as a rule; or no longer to be written to
        finally:
            os.close(file)

    def _is_named(self, file: int) -> bool:
        """Whether the open file is still the one that bears the name."""
        try:
            return os.path.samestat(os.fstat(file), self.path.stat())
        except FileNotFoundError:
            return False


def is_locked(folder: Path) -> bool:
    """Whether a process runs the job of this folder; nothing is changed by asking."""
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
