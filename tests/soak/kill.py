"""Kill a real sweep at random instants, run it again until it is done, compare every byte.

    python tests/soak/kill.py [--kills 20] [--seed 0] [--keep]

A round is a sweep in a new folder: ``scripts/train.py`` runs in a process of its own and gets a
signal at a random instant, again and again, until it ends by itself. After every signal, what is
finished must stay finished, and no file may say what is not so; at the end all files must be those
of a run without a signal, except wall-clock columns, ``run.json``, ``.hydra/`` and Hydra's own.

Processes are forked from one that has imported torch and compiled the kernels, so that a kill costs
tenths of a second instead of the seconds of an import, and hits training instead of imports.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import re
import runpy
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
SCRIPT = ROOT / "scripts" / "train.py"
COMMON = ["-m", "experiment=debug", "score_threshold=150", "score_window=20"]
SWEEPS = {
    "fused": [
        "trials=40", "max_iterations=300", "strategy=softmax,decaying_epsilon_greedy,argmax",
        "checkpoint_seconds=0.02",
    ],
    "shards": [
        "trials=1000", "threads=2", "max_iterations=60", "strategy=softmax,epsilon_greedy",
        "checkpoint_seconds=0.05",
    ],
    "every iteration": [
        "trials=5", "max_iterations=60", "strategy=epsilon_greedy,softmax", "episodes_per_update=2",
        "optimizer=torch", "optimizer.name=Adam", "checkpoint_seconds=0",
    ],
    "torchrl": [
        "trials=3", "max_iterations=12", "strategy=epsilon_z_greedy,parameter_noise",
        "collector=torchrl", "baseline=step_mean", "checkpoint_seconds=0.1",
    ],
    "learning beside": [
        "trials=6", "max_iterations=40", "strategy=vdbe,count_bonus", "baseline=episode_mean",
        "evaluate_every=3", "diagnostics=true", "checkpoint_seconds=0",
    ],
    "another environment": [
        "trials=20", "max_iterations=40", "strategy=softmax", "env=gym", "env.id=FrozenLake-v1",
        "score_threshold=0.9", "checkpoint_seconds=0",
    ],
}  # fmt: skip
SIGNALS = [signal.SIGKILL] * 3 + [signal.SIGTERM, signal.SIGINT]
LEFT = re.compile(r"/checkpoint/|/\.lock$")
CLEAN = {signal.SIGTERM: 143, signal.SIGINT: 130}
BIRTH = 0.3
"""Seconds after which a process serves signals itself; before, they end it as they end any."""
PROMPT = 15.0
"""Seconds within which a process that is asked to end has ended even on a very busy machine."""
slowest = 0.0
"""The longest that any has taken."""


class Ended(NamedTuple):
    """What became of a process: its status, negative for a signal, what it said, how long."""

    status: int
    stdout: str
    stderr: str
    seconds: float
    """From the start; where a signal was sent, from the signal."""


def start(arguments: list[str], folder: Path) -> int:
    """``python scripts/train.py *arguments`` in a process of its own; returns its id."""
    sys.stdout.flush()
    for name in ("stdout", "stderr"):  # a signal may end the process before it opens them
        (folder / name).write_bytes(b"")
    process = os.fork()
    if process:
        return process
    code = 1
    try:
        for number, name in ((1, "stdout"), (2, "stderr")):
            os.dup2(os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        os.chdir(folder)
        sys.argv = [str(SCRIPT), *arguments]
        os.environ.pop("HYDRA_FULL_ERROR", None)
        runpy.run_path(str(SCRIPT), run_name="__main__")
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else int(error.code is not None)
    except BaseException as error:
        sys.excepthook(type(error), error, error.__traceback__)
    finally:
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
        os._exit(code)


def run(arguments: list[str], folder: Path, signum: int | None = None, after: float = 0.0) -> Ended:
    """Run the command in ``folder``; send it a signal ``after`` so many seconds."""
    began = time.monotonic()
    process = start(arguments, folder)
    if signum is not None:
        deadline = began + after
        ended = (0, 0)
        while ended[0] == 0 and time.monotonic() < deadline:
            time.sleep(min(0.005, max(0.0, deadline - time.monotonic())))
            ended = os.waitpid(process, os.WNOHANG)
        if ended[0]:
            return _ended(ended[1], folder, time.monotonic() - began)
        began = time.monotonic()
        os.kill(process, signum)
    return _ended(os.waitpid(process, 0)[1], folder, time.monotonic() - began)


def _ended(status: int, folder: Path, seconds: float) -> Ended:
    texts = ((folder / name).read_text() for name in ("stdout", "stderr"))
    return Ended(os.waitstatus_to_exitcode(status), *texts, seconds)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a sweep that must be the same, and what it must say."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_dir() or ".hydra" in path.parts or path.name == "multirun.yaml":
            continue
        data = path.read_bytes()
        if path.name == "run.json":
            data = b"there"
        if path.name == "trials.csv":
            data = without(data, "seconds")
        found[name] = data
    return found


def without(table: bytes, column: str) -> bytes:
    """A CSV table but one column."""
    rows = [line.split(",") for line in table.decode().splitlines()]
    place = rows[0].index(column)
    return "\n".join(",".join(row[:place] + row[place + 1 :]) for row in rows).encode()


def finished(files: dict[str, bytes]) -> set[str]:
    """The jobs that say that they are finished."""
    return {name.removesuffix("/run.json") for name in files if name.endswith("/run.json")}


def difference(files: dict[str, bytes], expected: dict[str, bytes]) -> str | None:
    """The first file in which two sweeps differ, in words; None if there is none."""
    for name in sorted({*files, *expected}):
        if files.get(name) == expected.get(name):
            continue
        if name not in files or name not in expected:
            return f"{name} is {'missing' if name not in files else 'left over'}"
        lines = [data.splitlines() for data in (files[name], expected[name])]
        for k, (one, two) in enumerate(zip(*lines, strict=False), start=1):
            if one != two:
                return f"{name}, line {k}: {one[:80]!r}, and without a signal {two[:80]!r}"
        return f"{name} has {len(lines[0])} lines, and without a signal {len(lines[1])}"
    return None


class BrokenPromiseError(Exception):
    """A promise that was not kept."""


def check_after(ended: Ended, signum: int, before: set[str], folder: Path, expected) -> set[str]:
    """Hold what a signal left behind against the promises; returns the finished jobs."""
    files = contents(folder) if folder.exists() else {}
    done = finished(files)
    if lost := before - done:
        raise BrokenPromiseError(f"{sorted(lost)} had been finished")
    for job in done:
        mine, theirs = (
            {n: data for n, data in all_files.items() if n.startswith(f"{job}/")}
            for all_files in (files, expected)
        )
        # What a kill in a job's last moment left beside its files goes with the next run.
        mine = {n: d for n, d in mine.items() if n in theirs or not LEFT.search(n)}
        if found := difference(mine, theirs):
            raise BrokenPromiseError(f"a finished job is not what it should be: {found}")
    if "Traceback" in ended.stderr:
        raise BrokenPromiseError(f"a traceback:\n{ended.stderr}")
    if signum in CLEAN:
        if ended.status not in (0, CLEAN[signum]):
            raise BrokenPromiseError(f"status {ended.status} after {signal.Signals(signum).name}")
        if ended.status and "same command" not in ended.stderr:
            raise BrokenPromiseError(f"no word on how to go on: {ended.stderr!r}")
        global slowest
        slowest = max(slowest, ended.seconds)
        if ended.status and ended.seconds > PROMPT:
            raise BrokenPromiseError(
                f"{ended.seconds:.1f} s to end after {signal.Signals(signum).name}"
            )
    return done


def one_round(
    name: str, expected: dict[str, bytes], seconds: float, place: Path, rng: random.Random
) -> Counter[str]:
    """Kill one sweep until it is done, and compare."""
    arguments = [*COMMON, *SWEEPS[name]]
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    folder, counts = place / "outputs", Counter()
    done: set[str] = set()
    while True:
        signum = rng.choice(SIGNALS)
        after = rng.uniform(0, 1.2 * seconds)
        ended = run(arguments, place, signum, after)
        if ended.status == 0:
            break
        if ended.status not in (-signum, CLEAN.get(signum)):
            raise BrokenPromiseError(f"status {ended.status}: {ended.stderr}")
        counts[signal.Signals(signum).name] += 1
        if ended.status == -signum and after < BIRTH:
            signum = signal.SIGKILL  # nobody was there yet to see it
        done = check_after(ended, signum, done, folder, expected)
    if found := difference(contents(folder), expected):
        raise BrokenPromiseError(found)
    return counts


def soak(kills: int, seed: int, place: Path) -> Counter[str]:
    """Rounds until there have been so many kills; returns how many of each signal."""
    references = {}
    for name, sweep in SWEEPS.items():
        folder = place / "reference" / name
        folder.mkdir(parents=True)
        ended = run([*COMMON, *sweep], folder)
        if ended.status:
            raise BrokenPromiseError(f"without a signal, {name}: {ended.stderr}")
        references[name] = contents(folder / "outputs"), ended.seconds
    total: Counter[str] = Counter()
    number = 0
    while total.total() < kills:
        for name, (expected, seconds) in references.items():
            rng = random.Random(f"{seed} {number}")
            number += 1
            try:
                counts = one_round(name, expected, seconds, place / "round", rng)
            except BrokenPromiseError as failure:
                raise BrokenPromiseError(
                    f"round {number} ({name}), seed {seed}: {failure}"
                ) from None
            total += counts
    print(
        f"{total.total()} kills in {number} sweeps "
        f"({', '.join(f'{n} {s}' for s, n in sorted(total.items()) if n)}): every file the same"
    )
    print(f"the slowest answer to SIGTERM or SIGINT took {slowest:.1f} s")
    return total


def warm_up(place: Path) -> None:
    """Import and compile what the sweeps need, so that the forks have it."""
    import torch

    torch.set_num_threads(1)
    place.mkdir()
    arguments, folder = sys.argv, Path.cwd()
    streams = [os.dup(number) for number in (1, 2)]
    os.chdir(place)
    try:
        for number in (1, 2):  # the streams themselves stay, since modules keep hold of them
            os.dup2(os.open(os.devnull, os.O_WRONLY), number)
        for sweep in SWEEPS.values():
            sys.argv = [str(SCRIPT), *COMMON, *sweep, "trials=1", "max_iterations=1"]
            with contextlib.suppress(SystemExit):
                runpy.run_path(str(SCRIPT), run_name="__main__")
        sys.stdout.flush()
    finally:
        for number, stream in enumerate(streams, start=1):
            os.dup2(stream, number)
        sys.argv = arguments
        os.chdir(folder)
        for signum in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(signum, signal.SIG_DFL)


def main() -> int:
    """Parse the command line and soak."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=20, help="at least (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the instants and signals")
    parser.add_argument("--keep", action="store_true", help="keep the folders")
    arguments = parser.parse_args()
    place = Path(tempfile.mkdtemp(prefix="trl_explore-soak-"))
    try:
        warm_up(place / "warm")
        soak(arguments.kills, arguments.seed, place)
    except BrokenPromiseError as failure:
        print(f"FAILED: {failure}\nfolders: {place}", file=sys.stderr)
        return 1
    if not arguments.keep:
        shutil.rmtree(place)
    return 0


if __name__ == "__main__":
    sys.exit(main())
