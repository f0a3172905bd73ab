"""The machine and the packages used for the measurements."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("torch", "torchrl", "tensordict", "gymnasium", "numpy", "numba")


def cores() -> int:
    """The number of processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def cpu_model() -> str:
    """The processor's name."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def load() -> str:
    """The load average of the machine over one minute."""
    return f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"


def description() -> list[tuple[str, str]]:
    """Names and values of the facts that a reader needs to judge the numbers."""
    python = f"{platform.python_implementation()} {platform.python_version()}"
    return [
        ("processor", f"{cpu_model()}, {platform.machine()}"),
        ("cores", f"{cores()}; one is used unless the table states two threads"),
        ("system", platform.system()),
        ("Python", python),
        ("packages", ", ".join(f"{name} {version(name)}" for name in PACKAGES)),
    ]
