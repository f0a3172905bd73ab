"""Measurements of whole processes: start-up time and peak memory.

``python benchmarks/processes.py TRIALS ITERATIONS`` trains softmax trials with the fused collector
and prints the peak resident memory of the process in bytes, after the imports and at the end.
"""

from __future__ import annotations

import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

TRAIN = Path(__file__).resolve().parent.parent / "scripts" / "train.py"
IMPORT = "import torchrl.envs, torchrl.collectors, torchrl.objectives"


def commands(folder: Path) -> dict[str, list[str]]:
    """The commands to time, by name."""
    output = f"output_dir={folder}"
    return {
        "train.py --help": [str(TRAIN), "--help"],
        "import torchrl": ["-c", IMPORT],
        "train.py experiment=debug": [str(TRAIN), "experiment=debug", output],
        "train.py": [str(TRAIN), output],
    }


def start_up() -> dict[str, float]:
    """Wall-clock seconds of each command, as a separate process."""
    seconds = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in commands(Path(folder)).items():
            started = time.perf_counter()
            subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
            seconds[name] = time.perf_counter() - started
    return seconds


def memory(trials: int, max_iterations: int) -> tuple[float, float]:
    """Peak resident memory of a process in GB, after its imports and after training."""
    command = [sys.executable, __file__, str(trials), str(max_iterations)]
    result = subprocess.run(command, check=True, capture_output=True, text=True)
    imported, trained = (int(word) / 1e9 for word in result.stdout.split())
    return imported, trained


def peak() -> int:
    """Peak resident memory of this process in bytes."""
    status = Path("/proc/self/status")
    if status.is_file():  # on Linux, getrusage starts at the peak of the parent process
        found = re.search(r"VmHWM:\s*(\d+) kB", status.read_text(encoding="utf-8"))
        if found is not None:
            return 1024 * int(found[1])
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main() -> None:
    """Train and print the peaks."""
    from runs import fused

    trials, max_iterations = map(int, sys.argv[1:])
    fused("softmax", 1, max_iterations=2)
    imported = peak()
    fused("softmax", trials, max_iterations=max_iterations)
    print(imported, peak())


if __name__ == "__main__":
    main()
