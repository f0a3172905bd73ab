"""TensorBoard event files, as CleanRL, Tianshou, skrl, Stable-Baselines3 and RLlib write them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from trl_explore.jobs.files import ResultsError
from trl_explore.logs.log import Log, Points, by_folder, files_below, hydra_facts, place_of

SCORES = (
    "charts/episodic_return", "rollout/ep_rew_mean", "train/reward", "train/returns_stat/mean",
    "Reward / Total reward (mean)", "ray/tune/env_runners/episode_return_mean",
    "ray/tune/episode_reward_mean", "train/episode_reward", "eval/mean_reward", "test/reward",
    "test/returns_stat/mean", "eval/reward", "eval/episodic_return", "episode_reward",
    "episodic_return", "reward",
)  # fmt: skip
EPISODES = frozenset({"charts/episodic_return", "eval/episodic_return"})


def read(folder: Path) -> Iterator[Log]:
    """The runs at or below a folder: folders with event files.

    Raises:
        ResultsError: the package ``tensorboard`` is not installed.
    """
    try:
        from tensorboard.backend.event_processing import event_accumulator as events
    except ModuleNotFoundError:
        raise ResultsError(
            "reading event files needs tensorboard: pip install 'trl_explore[logs]'"
        ) from None
    for place, files in by_folder(files_below(folder, ["events.out.tfevents.*"])):
        # The steps of a continued run go back; the values that it replaces are dropped later.
        run = events.EventAccumulator(
            str(files[0] if folder.is_file() else place),
            size_guidance={"scalars": 0, "tensors": 0, "images": 1, "histograms": 1, "audio": 1},
            purge_orphaned_data=False,
        ).Reload()
        tags = run.Tags()

        def load(name: str, run: events.EventAccumulator = run) -> Points:
            if name in run.Tags()["scalars"]:
                points = [(event.step, event.value) for event in run.Scalars(name)]
            else:
                points = [(e.step, _scalar(e.tensor_proto)) for e in run.Tensors(name)]
            step, value = np.array(points, dtype=np.float64).reshape(-1, 2).T
            return step, value

        names = [*tags["scalars"], *(t for t in tags["tensors"] if _is_scalar(run, t))]
        started = float(run.FirstEventTimestamp() or 0.0) if names else 0.0
        notes = [f"{len(files)} event files"] if len(files) > 1 else []
        yield Log(
            place_of(place, folder if folder.is_dir() else folder.parent),
            names, load, episodes=EPISODES, facts=hydra_facts(place, folder), notes=notes,
            started=started,
        )  # fmt: skip


def _is_scalar(run: object, tag: str) -> bool:
    proto = run.Tensors(tag)[0].tensor_proto  # type: ignore[attr-defined]
    return proto.dtype in (1, 2) and np.prod([d.size for d in proto.tensor_shape.dim]) == 1


def _scalar(proto: object) -> float:
    from tensorboard.util.tensor_util import make_ndarray

    return float(make_ndarray(proto).ravel()[0])
