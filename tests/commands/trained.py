"""What ``scripts/train.py`` leaves and says."""

from __future__ import annotations

from pathlib import Path

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "train.py"
TINY = ["trials=2", "max_iterations=3"]
NAMES = {
    "random": "random",
    "argmax": "argmax",
    "epsilon_greedy": "epsilon_greedy,epsilon=0.3",
    "decaying_epsilon_greedy": "decaying_epsilon_greedy,decay=0.99",
    "softmax": "softmax,temperature=1.0",
}
STRATEGIES = list(NAMES)
RESULTS = {
    "trials.csv", "episodes.csv", "evaluations.csv", "run.json", "weights.safetensors", "scalars",
}  # fmt: skip


def complaints(process) -> list[str]:
    """What stands on stderr, apart from the line that says which collector is used."""
    return [line for line in process.stderr.splitlines() if not line.startswith("collector: ")]


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def results_below(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.name in RESULTS]
