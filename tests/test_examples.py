"""The programs in examples/ run, and learn what they say."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"

LEAST = {
    "dqn": 60.0,  # a random policy has 22, the best has 500
    "masked": 5.0,  # a random policy has about -200, the best has 7.9
    "ppo": 150.0,  # the best has 500
    "reinforce_workers": 70.0,  # a random policy has 19, the best has 200
    "two_agents": 6.0,  # random moves have 0.8, the best have about 9.5
}
"""The least number that an example prints."""


@pytest.mark.parametrize("name", LEAST)
def test_an_example_learns(name):
    # One thread: the programs are small, and the tests run side by side.
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(EXAMPLES.parent)}
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py")],
        capture_output=True, text=True, timeout=600, env=environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    line = done.stdout.strip().splitlines()[-1]
    found = re.fullmatch(r"[a-z ]+: (-?[0-9.]+)", line)
    assert found, done.stdout
    assert float(found[1]) >= LEAST[name], line


def test_examples_are_short_and_all_are_tested():
    files = {path.stem: path.read_text(encoding="utf-8") for path in EXAMPLES.glob("*.py")}
    assert files.keys() == LEAST.keys()
    assert all(text.count("\n") < 80 and text.startswith('"""') for text in files.values())
