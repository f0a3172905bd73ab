"""TorchRL's ``CSVLogger``: ``scalars/NAME.csv`` with lines of step and value, without a header."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from trl_explore.logs.log import Log, Points, files_below, hydra_facts, numbers, place_of, read_csv

SCORES = (
    "train/reward", "train/episode_reward", "train/reward_episode", "reward_training", "r_training",
    "collection/reward", "eval/reward", "eval/episode_reward", "evaluation/reward", "r_evaluation",
    "score", "episode_reward", "reward",
)  # fmt: skip
STAMP = re.compile(r"_[0-9a-f]{8}_\d\d_\d\d_\d\d-\d\d_\d\d_\d\d$")
"""What ``generate_exp_name`` adds to a name."""


def read(folder: Path) -> Iterator[Log]:
    """The runs at or below a folder: folders with a folder ``scalars``."""
    for scalars in sorted({folder / "scalars", *folder.rglob("scalars")}):
        names = {
            file.relative_to(scalars).with_suffix("").as_posix(): file
            for file in files_below(scalars, ["*.csv"])
        }
        if names:
            place = STAMP.sub("", place_of(scalars.parent, folder))

            def load(name: str, files: dict[str, Path] = names) -> Points:
                frame = read_csv(files[name], header=False)
                return numbers(frame[0]), numbers(frame[1])

            started = max(file.stat().st_mtime for file in names.values())
            facts = hydra_facts(scalars.parent, folder)
            yield Log(place, list(names), load, facts=facts, started=started)
