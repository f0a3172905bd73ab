"""A small map: the corners of CartPole, and some cells of the other environments."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from trl_explore.commands import map as command

SHORT = "max_iterations=6 score_window=2 score_threshold=18 evaluate_confirm=20"


def few() -> Iterator[str]:
    """Three corners and ε-greedy with one correction, a cell with both, and two other tasks."""
    for point in (*command.triangle(1), (0.7, 0.0, 0.3)):
        weights = zip(("greedy", "softmax", "uniform"), point, strict=True)
        words = " ".join(f"strategy.{name}={w}" for name, w in weights)
        yield f"env=cartpole strategy=mixture {words} {SHORT}"
    yield f"env=cartpole strategy=decaying_epsilon_greedy {SHORT}"
    yield f"env=cartpole strategy=mixture strategy.temperature=2 {SHORT}"
    yield f"env=cartpole strategy=mixture correction=per_step {SHORT}"
    for name in ("FrozenLake", "Catch"):
        task = command.TASKS[name].replace("evaluate_confirm=500", "evaluate_confirm=20")
        task = task.replace("score_threshold=0.7", "")
        yield f"{task} strategy=mixture {SHORT.replace('=18', '=0.5')}"


class Map(NamedTuple):
    """The folder of the jobs, what was read from them, and the page."""

    jobs: Path
    found: dict[str, Any]
    html: str


@pytest.fixture(scope="session")
def made_map(tmp_path_factory) -> Map:
    from trl_explore.show.map import page, read_cells

    jobs = tmp_path_factory.mktemp("map")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "plan", lambda full: few())
        patch.setattr("sys.argv", ["trl-explore map"])
        assert command.train_cells(jobs, 5, full=False) == 0
    found = read_cells(jobs)
    return Map(jobs, found, page(found))
