"""Every file of conf/experiment has a title, and is drawn from a tiny run of it."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from trl_explore.config import CONF
from trl_explore.names import EXPERIMENTS
from trl_explore.report.groups import group_jobs
from trl_explore.report.loading import load
from trl_explore.report.writing import build_report

NAMES = sorted(path.stem for path in (CONF / "experiment").glob("*.yaml"))
LAYOUTS = {
    "corrections": "crossed", "corrections_temperature": "crossed", "baselines": "crossed",
    "baselines_batch": "crossed", "deep_policy": "crossed", "frozenlake": "crossed",
    "why": "crossed",
    "mixture_plane": "plane",
}  # fmt: skip


@pytest.fixture(scope="module")
def runs(run_many, tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("experiments")
    words = "trials=2 max_iterations=3 score_window=2 checkpoint_seconds=1e9 output_dir=."
    commands = [[f"experiment={name}", *words.split(), *smaller(name)] for name in NAMES]
    for ran in run_many(commands, place):
        assert ran.returncode == 0, ran
    return place


def smaller(name: str) -> list[str]:
    """The sweep of an experiment with the first values of all it varies, as few as a layout has."""
    if name == "thesis":  # a part of it has another title
        return []
    params = yaml.safe_load((CONF / "experiment" / f"{name}.yaml").read_text()).get("hydra", {})
    swept = params.get("sweeper", {}).get("params", {})
    few = 3 if LAYOUTS.get(name) == "plane" else 2
    short = (f"{key}:'{','.join(str(v).split(',')[:few])}'" for key, v in swept.items())
    return [f"hydra.sweeper.params={{{','.join(short)}}}"] if swept else []


@pytest.mark.parametrize("name", NAMES)
def test_an_experiment_has_a_title_and_is_drawn(runs, tmp_path, name):
    (group,) = group_jobs(load([runs / name]).jobs)
    assert group.title == EXPERIMENTS[name].title
    layout = LAYOUTS.get(name)
    assert (group.crossed is not None) == (layout == "crossed")
    assert (group.plane is not None) == (layout == "plane")
    assert len(set(group.labels.values())) == len(group.configurations)
    assert not set(group.labels) & set(group.labels.values()) - {"softmax", "argmax", "random"}
    page, gaps = build_report([runs / name], tmp_path)
    assert not gaps
    assert EXPERIMENTS[name].title in page.read_text(encoding="utf-8")
    assert list((tmp_path / "figures").glob("*.svg"))


def test_another_environment_with_a_small_threshold(tmp_path, make_job):
    for slippery in ("FrozenLake-v1",):
        for strategy in ("softmax", "argmax"):
            make_job(tmp_path / "frozenlake", strategy, [150, 170, 1000], strategy=strategy,
                     env=slippery, threshold=0.78)  # fmt: skip
    (group,) = group_jobs(load([tmp_path]).jobs)
    assert (group.title, group.threshold) == ("FrozenLake", 0.78)
    page, gaps = build_report([tmp_path], tmp_path / "out")
    html = page.read_text(encoding="utf-8")
    assert not gaps
    assert "mean score above 0.78 over 100 episodes" in html
    assert "learned FrozenLake-v1" in html
    assert "CartPole" not in html
