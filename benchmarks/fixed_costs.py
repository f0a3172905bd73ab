"""What a job, a sweep and the program cost beside training, in processor time and memory.

    python benchmarks/fixed_costs.py [JOBS]

A sweep of JOBS (default 50) jobs with two trials of two iterations, less one of 10 jobs, shows what
each further job costs. Every row has its goal. Compiled code must be in the cache already: the
first row is run twice, and only the second time counts.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
TRAIN = [sys.executable, str(ROOT / "scripts" / "train.py")]
SMALL = ["trials=2", "max_iterations=2"]
FEW, MANY = 10, 50


class Cost(NamedTuple):
    """Processor time [s] and largest resident memory [MB] of a process."""

    seconds: float
    memory: float


def cost(command: list[str]) -> Cost:
    """The cost of a command.

    Raises:
        RuntimeError: if it fails.
    """
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with status {process.returncode}")
    return Cost(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def sweep(jobs: int) -> Cost:
    """The cost of a serial sweep of that many jobs."""
    seeds = "seed=" + ",".join(map(str, range(jobs)))
    with tempfile.TemporaryDirectory() as folder:
        return cost([*TRAIN, "-m", seeds, *SMALL, f"output_dir={folder}"])


def main() -> None:
    """Print the rows."""
    many = int(sys.argv[1]) if len(sys.argv) > 1 else MANY
    sweep(FEW)
    few, more = sweep(FEW), sweep(many)
    torchrl = cost([sys.executable, "-c", "import torchrl.envs, torchrl.modules, tensordict.nn"])
    with tempfile.TemporaryDirectory() as folder:
        one = cost([*TRAIN, *SMALL, f"output_dir={folder}"])
    shown = cost([*TRAIN, "--help"])
    rows = [
        ("a further job of a sweep, ms", 1000 * (more.seconds - few.seconds) / (many - FEW), 50),
        ("memory of a further job, kB", 1024 * (more.memory - few.memory) / (many - FEW), 10),
        ("one job beyond importing TorchRL, s", one.seconds - torchrl.seconds, 0.7),
        ("importing TorchRL, s", torchrl.seconds, None),
        ("--help, s", shown.seconds, None),
    ]
    print(f"| processor time and memory ({FEW} and {many} jobs) | measured | goal |\n|---|---|---|")
    for name, value, goal in rows:
        print(f"| {name} | {value:.3g} | {'' if goal is None else goal} |")


if __name__ == "__main__":
    main()
