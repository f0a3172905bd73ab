"""CSV files that Weights & Biases exports from a panel: one column for each run.

The columns are ``Step`` (or ``global_step``), then ``RUN - QUANTITY`` with ``RUN - QUANTITY__MIN``
and ``__MAX``. In a row, the field of a run that logged nothing at this step is empty.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from trl_explore.jobs.columns import ResultsError
from trl_explore.logs.log import Log, column_points, files_below, read_csv
from trl_explore.logs.tensorboard import EPISODES

SCORES = (
    "charts/episodic_return", "rollout/ep_rew_mean", "global_step/episodic_return",
    "episodic_return", "train/reward", "episode_reward", "score", "reward", "return",
)  # fmt: skip


def read(folder: Path) -> Iterator[Log]:
    """The runs of the exports at or below a folder, or of one file.

    Raises:
        ResultsError: a file has no column of a run.
    """
    for file in files_below(folder, ["*.csv"]):
        frame = read_csv(file)
        step, *columns = map(str, frame.columns)
        runs: dict[str, dict[str, str]] = {}
        for column in columns:
            run, dash, name = column.rpartition(" - ")
            if dash and not name.endswith(("__MIN", "__MAX")) and not name.startswith("_"):
                runs.setdefault(run, {})[name] = column
        if not runs:
            raise ResultsError(
                f"{file}: no column is named 'RUN - QUANTITY', as in a panel that W&B exports"
            )
        for run, names in runs.items():
            yield Log(
                run,
                list(names),
                lambda name, frame=frame, step=step, names=names: column_points(
                    frame, step, names[name]
                ),
                step,
                episodes=EPISODES,
            )
