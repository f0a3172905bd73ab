"""A lock that allows one process at a time in a folder."""

from __future__ import annotations

import logging
import os
import socket
import threading
import time
from importlib import import_module
from pathlib import Path
from typing import Any

try:
    fcntl: Any = import_module("fcntl")
except ModuleNotFoundError:
    fcntl = None  # on Windows, where results can be read, but nothing can be trained

NAME = ".lock"
PATIENCE = 0.2
"""Seconds to retry a lock; ``is_locked`` holds it only for microseconds."""
BLOCKED = 5.0
"""Seconds after which a lock that must not wait counts as missing."""
RECENT = 900.0
"""Age of a checkpoint [s] up to which a process on another computer counts as running."""

logger = logging.getLogger(__name__)
_reasons: dict[int, str] = {}
"""Device -> why its file system has no locks; empty if it has."""


class LockedError(OSError):
    """Another process holds the lock of the folder; the message is one line."""


class Lock:
    """Hold a folder for this process until the lock is released or the process ends.

    An advisory lock (flock) on the file ``.lock`` in the folder. The kernel releases it when the
    process dies, so that a kill needs no clean-up. Releasing the lock deletes the file, and the
    folder if it is empty. A process that opened the file just before then locks a deleted file, or
    finds no folder to create the file in; it detects this and tries again.

    Some file systems (NFS, Lustre, FUSE) have no such lock: the call fails, never returns, or
    excludes no other process. One warning says so, and the file, which is created only if there is
    none, names the process. If that process ran on this computer and has ended, the file is
    replaced. Whether a process on another computer has ended is unknown: the user deletes the file.

    Args:
        folder: the folder; created if it does not exist.
        wait: whether to wait until the other process has released the lock.

    Raises:
        LockedError: if another process holds the lock.
        OSError: if the folder cannot be written to.
    """

    def __init__(self, folder: Path, *, wait: bool = False) -> None:
        self.folder, self.path, self.wait = folder, folder / NAME, wait
        self._file = -1

    def __enter__(self) -> Lock:
        if fcntl is None:
            raise OSError("training needs the file locks of Linux or macOS; on Windows, use WSL")
        deadline = time.monotonic() + PATIENCE
        while self._file < 0:
            self.folder.mkdir(parents=True, exist_ok=True)
            try:
                self._file = self._named() if _reason(self.folder) else self._locked()
            except FileNotFoundError:  # another process has just removed the empty folder
                if time.monotonic() > deadline:
                    raise
            except (BlockingIOError, LockedError) as error:
                if self.wait and is_locked(self.folder):
                    deadline = time.monotonic() + 10 * PATIENCE
                if time.monotonic() > deadline:
                    if isinstance(error, LockedError):
                        raise
                    raise LockedError(
                        f"{self.folder} is in use: another process runs this job"
                    ) from None
                time.sleep(PATIENCE if self.wait else PATIENCE / 10)
        return self

    def _locked(self) -> int:
        """The locked file; -1 if the lock must be tried again."""
        file, held = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666), False
        try:
            _flock(file, fcntl.LOCK_EX)
            held = _is_named(file, self.path) and self._excludes()
        except BlockingIOError:
            raise
        except OSError as error:
            _complain(self.folder, error.strerror or str(error))
        finally:
            if not held:
                os.close(file)
        return file if held else -1

    def _excludes(self) -> bool:
        """Whether the lock on a file excludes others; looked at once for each file system."""
        device = self.folder.stat().st_dev
        if device not in _reasons:
            other = os.open(self.path, os.O_RDWR | os.O_CLOEXEC)
            try:
                _flock(other, fcntl.LOCK_EX)
            except BlockingIOError:
                _reasons[device] = ""
            else:
                _complain(self.folder, "they exclude no process")
            finally:
                os.close(other)
        return not _reasons[device]

    def _named(self) -> int:
        """The file that names this process; -1 if it must be tried again."""
        try:
            file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError:
            text = _text(self.path)
            if not text:  # another process may be about to write it
                time.sleep(PATIENCE)
                text = _text(self.path)
            if text and _runs(text) is not False:
                host, pid, _ = text.split()
                raise LockedError(
                    f"{self.folder} is in use by process {pid} on {host}; if that has ended, "
                    f"delete {self.path}"
                ) from None
            self.path.unlink(missing_ok=True)
            return -1
        os.write(file, f"{socket.gethostname()} {os.getpid()} {_birth(os.getpid())}".encode())
        return file

    def __exit__(self, *error: object) -> None:
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


def is_locked(folder: Path) -> bool:
    """Whether a process runs the job of this folder; changes nothing."""
    if fcntl is None:
        return False
    path = folder / NAME
    try:
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        if not _reason(folder):
            _flock(file, fcntl.LOCK_SH)
    except BlockingIOError:
        return True
    except OSError as error:
        _reasons[folder.stat().st_dev] = error.strerror or str(error)
    finally:
        os.close(file)
    text = _text(path)  # only where locks do not work
    runs = _runs(text) if text else False
    return _is_recent(folder) if runs is None else runs


def _flock(file: int, kind: int) -> None:
    """Lock a file without waiting.

    Raises:
        BlockingIOError: if another process holds the lock.
        OSError: if the file system has no locks; also if the call waits.
    """
    ended: list[OSError | None] = []

    def lock() -> None:
        try:
            fcntl.flock(file, kind | fcntl.LOCK_NB)
            ended.append(None)
        except OSError as error:
            ended.append(error)

    thread = threading.Thread(target=lock, daemon=True)
    thread.start()
    thread.join(BLOCKED)
    error = ended[0] if ended else OSError(f"no answer within {BLOCKED:.0f} s")
    if error is not None:
        raise error


def _reason(folder: Path) -> str:
    """Why the file system of a folder has no locks, if that is known; empty if it may have."""
    return _reasons.get(folder.stat().st_dev, "")


def _complain(folder: Path, reason: str) -> None:
    _reasons[folder.stat().st_dev] = reason
    logger.warning(
        "no file locks in %s (%s): %s files name the process instead; never run one job on two "
        "computers at a time, or choose another output_dir", folder.parent, reason, NAME,
    )  # fmt: skip


def _is_named(file: int, path: Path) -> bool:
    """Whether the open file is still the one at ``path``."""
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False


def _text(path: Path) -> str:
    """The host, process and start in a lock file; empty if it holds no such words."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")[:400] if path.is_file() else ""
    except OSError:
        return ""
    words = text.split()
    return text if len(words) == 3 and words[1].isdecimal() else ""


def _runs(text: str) -> bool | None:
    """Whether the process that a lock file names runs; None on another computer: unknown."""
    host, pid, birth = text.split()
    if host != socket.gethostname():
        return None
    return is_alive(int(pid)) and _birth(int(pid)) == birth


def is_alive(pid: int) -> bool:
    """Whether a process of this computer runs; a zombie does not."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        pass  # the process of another user
    return _stat(pid, 0) != "Z"


def _birth(pid: int) -> str:
    """When a process started, in the kernel's units: a new process may get an old number."""
    return _stat(pid, 19)


def _stat(pid: int, place: int) -> str:
    """A field that Linux shows of a process, counted from its state; a dash if it is unknown."""
    try:
        text = Path(f"/proc/{pid}/stat").read_bytes().decode(errors="replace")
        return text.rpartition(")")[2].split()[place]
    except (OSError, IndexError):
        return "-"


def _is_recent(folder: Path) -> bool:
    """Whether a job has written its lock or a checkpoint lately."""
    paths = [folder / NAME, *(folder / "checkpoint").glob("*/*")]
    try:
        return time.time() - max(path.stat().st_mtime for path in paths) < RECENT
    except OSError:
        return False
