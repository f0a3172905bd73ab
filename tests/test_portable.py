"""What works without the modules and names that only Unix has: all but training."""

from __future__ import annotations

import subprocess
import sys

import pytest

WINDOWS = """
import os, signal, sys
import torch, numba  # both ask sys.platform which names there are
for name in ("fcntl", "resource", "pwd", "grp", "termios", "pty"):
    sys.modules[name] = None
lacking = ["fork", "register_at_fork", "getuid", "geteuid", "killpg", "setsid", "fchmod",
           "sched_getaffinity", "O_CLOEXEC", "O_NONBLOCK", "O_NOFOLLOW", "O_DIRECTORY"]
for name in lacking:
    delattr(os, name)
known = {"SIGINT", "SIGTERM", "SIGABRT", "SIGFPE", "SIGILL", "SIGSEGV", "SIG_DFL", "SIG_IGN"}
for name in [name for name in vars(signal) if name.startswith("SIG") and name not in known]:
    delattr(signal, name)
del signal.setitimer, signal.ITIMER_REAL, signal.alarm
from trl_explore.commands.main import main
"""
ROOMS = [
    "statistics", "strategies", "envs", "policies", "objectives", "collectors", "training.trainer",
    "jobs", "thesis", "report",
]  # fmt: skip


def windows(code: str, cwd) -> subprocess.CompletedProcess[str]:
    """Run code where the names that Windows lacks are missing."""
    command = [sys.executable, "-c", WINDOWS + code]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def sweep(run_many, tmp_path_factory):
    place = tmp_path_factory.mktemp("portable")
    words = ["-m", "experiment=debug", "strategy=softmax,random", "max_iterations=5"]
    (ran,) = run_many([words], place)
    assert ran.returncode == 0, ran.stderr
    return place / "outputs" / "debug"


def test_everything_is_imported_and_results_are_read(sweep, tmp_path):
    done = windows(
        f"""
from importlib import import_module
for room in {ROOMS}:
    import_module("trl_explore." + room)
frame = import_module("trl_explore").read_frame([{str(sweep)!r}])
print(len(frame))
print(main(["status", {str(sweep)!r}]))
print(main(["report", {str(sweep)!r}, "--out", "report"]))
""",
        tmp_path,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "6"
    assert "2 of 2 done" in done.stdout
    assert lines.count("0") == 2
    assert (tmp_path / "report" / "index.html").is_file()


def test_training_says_what_it_lacks(tmp_path):
    done = windows('sys.exit(main(["train", "experiment=debug"]))', tmp_path)
    assert done.returncode == 1
    assert done.stderr.splitlines() == [
        "error: training needs the file locks of Linux or macOS; on Windows, use WSL"
    ]
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
