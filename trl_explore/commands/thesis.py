"""The thesis's whole study: ``trl-explore thesis [--out DIR]``.

It runs the commands of ``STEPS`` in one process, which imports torch and TorchRL once. The same
command continues an interrupted study.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

from trl_explore.commands import main as commands
from trl_explore.jobs.console import printable

STEPS = (
    ("train", "experiment=thesis"),
    ("train", "experiment=epsilon_grid"),
    ("train", "experiment=decay_grid"),
    ("time", "thesis", "--trials", "30"),
    ("time", "decay_grid"),
    ("report", "thesis.yaml", "thesis", "epsilon_grid", "decay_grid"),
)
"""The commands, with folders relative to that of the study."""


def main() -> int:
    """Run all steps; stop at the first that fails, and return its status."""
    parser = argparse.ArgumentParser(
        description="Run the experiments of the thesis, time single trials, and write the report."
    )
    parser.add_argument(
        "--out", type=Path, default=Path("outputs"), help="folder of the study (%(default)s)"
    )
    for step in _steps(parser.parse_args().out):
        print(f"trl-explore {printable(' '.join(step))}", file=sys.stderr, flush=True)
        if status := commands.main(step):
            return status
    return 0


def _steps(out: Path) -> list[list[str]]:
    """The words of every step for a study in this folder."""
    folders = {words[1].partition("=")[2] for words in STEPS} - {""}
    steps = [[str(out / word) if word in folders else word for word in step] for step in STEPS]
    # Hydra's grammar takes a backslash as it is, unless a quote or the end follows.
    quoted = re.sub(r"(\\*)('|$)", lambda m: m[1] * 2 + m[2].replace("'", "\\'"), str(out))
    for step in steps:
        if step[0] == "train":
            step.append(f"output_dir='{quoted}'")
    steps[-1] += ["--out", str(out / "report")]
    return steps
