"""Train the agents of the map and write its page: ``trl-explore map [--full] [--out FILE]``.

Every cell is a separate job in the folder of the map, so the same command continues a map.
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path

from trl_explore.commands import train
from trl_explore.jobs.console import tell
from trl_explore.jobs.files import ResultsError, write_whole

TASKS = {
    "CartPole": "env=cartpole",
    "FrozenLake": "env=frozenlake +env.kwargs.is_slippery=false policy=tabular optimizer.lr=0.1"
    " evaluate_confirm=500",
    "Catch": "env=catch env.kwargs.rows=6 score_threshold=0.7 optimizer.lr=0.1"
    " evaluate_confirm=500",
}
"""The environments of the map. FrozenLake is not slippery, and Catch smaller and easier, so that
agents learn within the cap."""
CAP = 300
"""The most iterations of an agent: softmax needs about 150 in CartPole."""
CORRECTIONS = ("none", "per_step")


def triangle(steps: int) -> list[tuple[float, float, float]]:
    """The weights of argmax, softmax and uniform, in multiples of 1 / ``steps``.

    >>> triangle(1)
    [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)]
    """
    return [
        (g / steps, (steps - g - u) / steps, u / steps)
        for g in range(steps + 1)
        for u in range(steps + 1 - g)
    ]


def plan(full: bool) -> Iterator[str]:
    """The words of every cell's job: the thesis's temperature first, then the others.

    Cells without softmax do not depend on the temperature and are trained once.
    """
    for temperature in (1.0, 2.0, 0.5) if full else (1.0,):
        points = triangle(5 if full else 2)
        points = [p for p in points if temperature == 1 or p[1]]
        points += [(0.7, 0.0, 0.3)] if temperature == 1 else []  # the thesis's ε-greedy
        for task in TASKS.values():
            for correction in CORRECTIONS:
                start = f"{task} correction={correction} max_iterations={CAP} episodes=false"
                for g, s, u in points:
                    yield (
                        f"{start} strategy=mixture strategy.greedy={g} strategy.softmax={s} "
                        f"strategy.uniform={u} strategy.temperature={temperature}"
                    )
                if temperature == 1:
                    yield f"{start} strategy=decaying_epsilon_greedy"


def train_cells(folder: Path, trials: int, full: bool) -> int:
    """Train the cells that are not finished; returns the exit status."""
    jobs = list(plan(full))
    for k, words in enumerate(jobs, start=1):
        print(f"training cell {k} of {len(jobs)}", file=sys.stderr)
        sys.argv = ["trl-explore train", *words.split(), f"trials={trials}", f"output_dir={folder}"]
        with redirect_stdout(io.StringIO()):
            status = train.main()
        if status:
            return status
    return 0


def main() -> int:
    """Train and write the page; an error prints one line on stderr and returns status 1."""
    parser = argparse.ArgumentParser(
        description="Train agents of the mixtures of argmax, softmax and uniform, and write a page"
        " in which a reader moves through them."
    )
    parser.add_argument(
        "--full", action="store_true", help="318 cells of 1,000 agents, not 48 of 50"
    )
    parser.add_argument("--trials", type=int, help="agents of a cell")
    parser.add_argument(
        "--jobs", type=Path, default=Path("outputs/map"), metavar="DIR",
        help="folder of the cells' jobs (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="the page (default: map.html in that folder)"
    )
    parser.add_argument("--page", action="store_true", help="write the page of finished cells only")
    arguments = parser.parse_args()
    out = arguments.out or arguments.jobs / "map.html"
    try:
        trials = arguments.trials or (1000 if arguments.full else 50)
        if not arguments.page and (status := train_cells(arguments.jobs, trials, arguments.full)):
            return status
        from trl_explore.show.map import page, read_cells

        found = read_cells(arguments.jobs, lambda text: print(text, file=sys.stderr))
        write_whole(out, page(found).encode())
    except ResultsError as error:
        tell(error)
        return 1
    except OSError as error:
        tell(f"cannot write {error.filename}: {error.strerror}")
        return 1
    print(out)
    return 0
