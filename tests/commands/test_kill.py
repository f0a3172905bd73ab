"""A real sweep, killed at random instants: about twenty here, hundreds by ``make soak``."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

HARNESS = Path(__file__).parents[1] / "soak" / "kill.py"


def test_twenty_kills_change_no_byte():
    process = subprocess.run(
        [sys.executable, str(HARNESS), "--kills", "20", "--seed", "0"],
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    found = re.match(r"(\d+) kills in \d+ sweeps \(.*\): every file the same\n", process.stdout)
    assert found is not None, process.stdout
    assert int(found[1]) >= 20
