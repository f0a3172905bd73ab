"""The page on own kernels works as it stands, in a folder outside of the package."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "own_kernel.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL)
PROGRAM = "import sys; from trl_explore.commands.main import main; sys.exit(main())"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with every file of the page."""
    folder = tmp_path_factory.mktemp("own")
    for kind, text in BLOCKS:
        if kind == "sh":
            continue
        name = re.match(r"# ([\w./]+)", text)
        assert name is not None, text
        path = folder / name[1]
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(text)
    return folder


def run(folder: Path, command: str) -> subprocess.CompletedProcess[str]:
    """Run a command of the page, with this checkout's trl-explore."""
    program, *arguments = command.split()
    start = [sys.executable, "-c", PROGRAM] if program == "trl-explore" else [sys.executable]
    path = os.pathsep.join([str(folder), str(ROOT)])
    return subprocess.run(
        [*start, *arguments], cwd=folder, env={**os.environ, "PYTHONPATH": path},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_every_command(folder):
    commands = [line for kind, text in BLOCKS if kind == "sh" for line in text.splitlines()]
    commands.remove("export PYTHONPATH=$PWD")
    assert len(commands) == 3
    outputs = []
    for command in commands:
        done = run(folder, command)
        assert done.returncode == 0, done.stderr
        outputs.append(done.stdout + done.stderr)
    checked, fused, torchrl = outputs
    assert re.search(r"\d{4,} transitions and 200 terminations are the same", checked)
    assert "collector: fused\n" in fused
    assert "collector: fused" not in torchrl
    jobs = sorted((folder / "outputs" / "train").iterdir(), key=lambda job: "torchrl" in job.name)
    of_all, of_two = ((job / "episodes.csv").read_text().splitlines() for job in jobs)
    assert len(of_two) == 1 + 2 * 20
    assert [line for line in of_all if re.match("[01],|trial", line)][: len(of_two)] == of_two
    assert "0 (0%)" not in fused  # trials pass


def test_the_kernel_is_short():
    _, kernel = (text for kind, text in BLOCKS if kind == "python" and "corridor.py" in text[:20])
    assert len([line for line in kernel.splitlines() if line.strip()]) <= 30


def test_a_kernel_that_differs_is_told_where(folder):
    text = (folder / "corridor.py").read_text(encoding="utf-8")
    (folder / "wrong.py").write_text(text.replace("return -1.0, state", "return 0.0, state"))
    check = (folder / "check.py").read_text(encoding="utf-8").replace("corridor", "wrong")
    (folder / "check_wrong.py").write_text(check)
    done = run(folder, "python check_wrong.py")
    assert done.returncode != 0
    assert re.search(r"reward 0.0, not -1.0, in episode 0 at step 0, action \d", done.stderr)
