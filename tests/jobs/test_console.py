from __future__ import annotations

import io
import os
import re
import struct
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest

from trl_explore.jobs import console
from trl_explore.jobs.console import Progress, duration, table, warnings
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.training.trials import Trials


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def trials() -> Trials:
    """Two trials after two of ten iterations; one has converged."""
    trials = Trials(2, max_iterations=10, score_threshold=5, score_window=2)
    for scores in ([4.0, 3.0], [8.0, 3.0]):
        trials.record(np.array(scores), np.array([500, 250]), np.array([False] * 2), 1.0)
    return trials


@pytest.fixture
def clock(monkeypatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(console.time, "perf_counter", lambda: now[0])
    return now


@pytest.fixture
def screen(monkeypatch):
    """Make a terminal with so many columns; returns its stream."""

    def make(columns: int) -> Terminal:
        for name, value in {"COLUMNS": str(columns), "LINES": "5", "TERM": "xterm"}.items():
            monkeypatch.setenv(name, value)
        return Terminal()

    return make


def lines(text: str) -> list[str]:
    """What a terminal showed, without the codes that move the cursor or set a colour."""
    parts = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text).replace("\n", "\r").split("\r")
    return [part.rstrip() for part in parts if part.strip()]


def test_quiet_where_nobody_watches(trials, clock):
    stream = io.StringIO()
    progress = Progress("softmax", [trials], stream)
    clock[0] += 60
    progress()
    progress.close()
    assert stream.getvalue() == ""


def test_the_live_line(trials, clock, screen):
    stream = screen(120)
    progress = Progress("softmax", [trials], stream)
    progress.iterations = progress.frames = 0  # as if it had been there from the beginning
    clock[0] += 3.0
    progress()
    (line,) = lines(stream.getvalue())
    assert re.match(r"softmax .*\b2, .*\b1/2, .*\b4\.5, 500 frames/s", line)
    assert "12 s left" in line  # 3 s for 2 iterations, 8 to go
    assert "\033[?25l" not in stream.getvalue()  # the cursor stays visible if the program is killed
    progress.close()
    assert stream.getvalue().endswith("\033[2K")  # the line is removed


def test_the_live_line_of_a_sweep(trials, clock, screen):
    """The third of nine jobs, 40 s after the first began: 20 s each."""
    Progress("softmax", [trials], screen(200), (0, 9))
    clock[0] += 40
    for columns in (200, 30):
        stream = screen(columns)
        progress = Progress("argmax", [trials], stream, (2, 9))
        clock[0] += 1
        progress()
        (line,) = lines(stream.getvalue())
        assert line.startswith("3/9, then about 2 min: argmax" if columns == 200 else "")
        assert len(line) <= columns
        clock[0] -= 1


def test_the_live_line_is_refreshed_at_intervals(trials, clock, screen):
    stream = screen(120)
    progress = Progress("softmax", [trials], stream)
    lengths = [0]
    for _ in range(8):
        clock[0] += console.REFRESH * 0.4
        progress()
        lengths.append(len(stream.getvalue()))
    assert [b > a for a, b in pairwise(lengths)] == [
        False, False, True, False, False, True, False, False,
    ]  # fmt: skip


TIMED = """
import sys, time
from trl_explore.jobs.console import Bar
bar = Bar("a name that is much longer than the terminal is wide " + "x" * 90)
for k in range(3):
    time.sleep(0.21)
    if bar.due:
        bar.show(k, 3, f"{k}/3 trials")
bar.close()
print("done", file=sys.stderr)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminal")
def test_on_a_terminal_of_40_columns():
    import fcntl
    import pty
    import termios

    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 10, 40, 0, 0))
    plain = {name: text for name, text in os.environ.items() if name not in ("COLUMNS", "LINES")}
    process = subprocess.Popen(
        [sys.executable, "-c", TIMED], stdin=slave, stdout=slave, stderr=slave,
        env=plain | {"TERM": "xterm"},
    )  # fmt: skip
    os.close(slave)
    written = b""
    try:
        while part := os.read(master, 1000):
            written += part
    except OSError:
        pass  # the other end is closed
    os.close(master)
    assert process.wait() == 0
    *shown, last = lines(written.decode())
    assert last == "done"
    assert [re.search(r"(\d)/3 trials$", line)[1] for line in dict.fromkeys(shown)] == [
        "0",
        "1",
        "2",
    ]
    assert all(len(line) <= 40 and line.startswith("a name") for line in shown)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.2, "0 s"), (8.4, "8 s"), (99.0, "99 s"), (180.0, "3 min"), (9000.0, "2.5 h")],
)
def test_durations(seconds, text):
    assert duration(seconds) == text


def outcome(name: str, iterations: list[int], status: list[str], **changes) -> Outcomes:
    n = len(iterations)
    values = {
        "name": name,
        "experiment": "thesis",
        "strategy": name,
        "parameters": {},
        "config": {},
        "cap": 1000,
        "threshold": 195.0,
        "window": 100,
        "trial": np.arange(n),
        "seed": np.zeros(n, np.int64),
        "iterations": np.array(iterations),
        "converged": np.array([s == "converged" for s in status]),
        "score": np.linspace(100, 200, n),
        "frames": np.full(n, 12345),
        "seconds": np.full(n, 1.5),
        "status": np.array(status),
        "provenance": {"seconds": 7.25},
    }
    return Outcomes(**{**values, **changes})


def test_the_table_of_a_sweep():
    jobs = [
        outcome(
            "softmax",
            [140, 100, 120],
            ["converged"] * 3,
            learned=np.array([True, False, True]),
            iterations_to_learn=np.array([30, 100, 45]),
            frames_to_learn=np.array([300, 1000, 450]),
            learned_score=np.array([500.0, 9, 391]),
        ),
        outcome("argmax", [1000, 900, 1000], ["capped", "converged", "capped"]),
        outcome("worse", [7, 1000, 600], ["diverged", "capped", "converged"]),
        outcome("broken", [7, 500, 600, 3], ["diverged", "converged", "converged", "diverged"]),
    ]
    text = table(iter(jobs))
    header, rule, *rows = text.splitlines()
    assert header.split() == [
        "job", "trials", "passed", "after", "learned", "after", "mean", "score", "learned", "score",
        "frames", "seconds",
    ]  # fmt: skip
    assert set(rule) == {"-"}
    assert [" ".join(row.split()) for row in rows] == [
        "softmax 3 3 (100%) 120 2 (67%) 45 150.0 300.0 37,035 7.2",
        "argmax 3 1 (33%) > 1000 – – 150.0 – 37,035 7.2",
        "worse 3 1 (33%), 1 diverged > 1000 – – 150.0 – 37,035 7.2",
        "broken 4 2 (50%), 2 diverged 600 – – 150.0 – 49,380 7.2",
    ]
    ends = [len(row) for row in rows]
    assert len(set(ends)) == 1  # columns stand under each other


def test_a_job_of_which_nothing_converged():
    (row,) = table([outcome("random", [1000] * 4, ["capped"] * 4)]).splitlines()[2:]
    assert row.split()[2:8] == ["0", "(0%)", ">", "1000", "–", "–"]


def test_a_cap_before_the_first_full_window_is_told():
    jobs = [
        outcome("softmax", [50] * 2, ["capped"] * 2, cap=50),
        outcome("random", [100] * 2, ["capped"] * 2, cap=100),
        outcome("four", [25] * 2, ["capped"] * 2, cap=25, config={"episodes_per_update": 4}),
        outcome("greedy", [9] * 2, ["capped"] * 2, cap=9, config={"stop_on": "learned"}),
    ]
    (line,) = warnings(jobs[:1])
    assert re.search("max_iterations=50.*score_window=100", line)
    assert warnings(jobs[1:]) == []
