"""What is measured on whole processes: start-up, and the most memory a run needs.

``python benchmarks/processes.py TRIALS ITERATIONS`` trains softmax trials with the fused collector
and prints the peak of its resident memory in bytes, after the imports and at the end.
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
    """The commands whose seconds are measured, by name."""
    output = f"output_dir={folder}"
    return {
        "train.py --help": [str(TRAIN), "--help"],
        "import torchrl": ["-c", IMPORT],
        "train.py experiment=debug": [str(TRAIN), "experiment=debug", output],
        "train.py": [str(TRAIN), output],
    }


def start_up() -> dict[str, float]:
    """Seconds of each command, from the shell's point of view."""
    seconds = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in commands(Path(folder)).items():
            started = time.perf_counter()
            subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
            seconds[name] = time.perf_counter() - started
    return seconds


def memory(trials: int, max_iterations: int) -> tuple[float, float]:
    """Peak resident memory in GB of a process that only imports, and that trains."""
    command = [sys.executable, __file__, str(trials), str(max_iterations)]
    result = subprocess.run(command, check=True, capture_output=True, text=True)
    imported, trained = (int(word) / 1e9 for word in result.stdout.split())
    return imported, trained


def peak() -> int:
    """The most resident memory that this process has had, in bytes."""
    status = Path("/proc/self/status")
    if status.is_file():  # what getrusage says begins, on Linux, at the peak of the parent
        found = re.search(r"VmHWM:\s*(\d+) kB", status.read_text(encoding="utf-8"))
        if found is not None:
            return 1024 * int(found[1])
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main() -> None:
    """Train, and print the peaks."""
    from runs import fused

    trials, max_iterations = map(int, sys.argv[1:])
    fused("softmax", 1, max_iterations=2)
    imported = peak()
    fused("softmax", trials, max_iterations=max_iterations)
    print(imported, peak())


if __name__ == "__main__":
    main()
