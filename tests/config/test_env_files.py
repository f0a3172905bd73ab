"""The files of ``conf/env``: built, stepped, trained, and their numbers."""

from __future__ import annotations

import json
import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from omegaconf import OmegaConf
from torchrl.envs.utils import check_env_specs
from torchrl.modules import RandomPolicy

from trl_explore.config.building import STOPPING
from trl_explore.envs import lane_env, make_env
from trl_explore.envs.gym import reward_threshold
from trl_explore.envs.kernels import kernel_of

CONF = Path(__file__).resolve().parents[2] / "conf" / "env"
FILES = {
    path.stem: OmegaConf.create({"env": OmegaConf.load(path)}).env  # they refer to "env.…"
    for path in sorted(CONF.glob("*.yaml"))
}
ANY = {name: FILES.pop(name) for name in ("gym", "torchrl")}
FEATURES = {  # name: number of features, of actions or of their components
    "acrobot": (6, 3),
    "bipedalwalker": (24, 4),
    "bipedalwalker_hardcore": (24, 4),
    "cartpole": (4, 2),
    "cartpole_15": (4, 2),
    "cartpole_475": (4, 2),
    "catch": (50, 3),
    "cliffwalking": (48, 4),
    "deep_sea": (100, 2),
    "frozenlake": (16, 4),
    "frozenlake8x8": (64, 4),
    "lunarlander": (8, 4),
    "mountaincar": (2, 3),
    "mountaincar_sparse": (2, 3),
    "pendulum": (3, 1),
    "river_swim": (6, 2),
    "swing_up": (3, 3),
    "taxi": (500, 6),
    "two_rooms": (55, 4),
}
CONTINUOUS = ("bipedalwalker", "bipedalwalker_hardcore", "pendulum")
BOX2D = ("bipedalwalker", "bipedalwalker_hardcore", "lunarlander")
COMPILED = ("acrobot", "cartpole", "cartpole_15", "cartpole_475", "cliffwalking", "frozenlake")
COMPILED += ("frozenlake8x8", "mountaincar", "taxi")
COMPILED += ("catch", "deep_sea", "mountaincar_sparse", "river_swim", "swing_up", "two_rooms")


def named(names):
    """Parameters; those whose package is missing are skipped."""
    missing = find_spec("Box2D") is None
    skip = pytest.mark.skipif(missing, reason="needs the extra box2d")
    return [pytest.param(name, marks=skip if name in BOX2D else ()) for name in names]


def arguments(name: str) -> dict:
    node = OmegaConf.to_container(FILES[name], resolve=True)
    assert node.pop("_target_") == "trl_explore.envs.make_env"
    return {key: value for key, value in node.items() if key not in STOPPING}


def test_every_file_is_known():
    assert set(FEATURES) == set(FILES)


@pytest.mark.parametrize("name", named(FILES))
def test_it_is_built_and_stepped(name):
    env = make_env(trials=3, **{**arguments(name), "max_steps": 7})
    n_features, n_actions = FEATURES[name]
    td = env.rollout(9, RandomPolicy(env.action_spec), break_when_any_done=False)
    assert td["observation"].shape == (3, 9, n_features)
    if name in CONTINUOUS:
        assert td["action"].shape == (3, 9, n_actions)
    else:
        assert env.action_spec.space.n == n_actions
        assert td["action"].shape == (3, 9)
    assert td["next", "reward"].isfinite().all()
    assert td["next", "done"].any(1).all()
    assert ("action_mask" in td) == (name == "taxi")
    assert lane_env(env).max_steps == 7
    check_env_specs(env, break_when_any_done="both")
    env.close()


@pytest.mark.parametrize("name", named(FILES))
def test_its_numbers_are_gymnasiums(name):
    """Threshold and limit as registered, where the file does not say whose they are."""
    node, spec = FILES[name], gym.spec(FILES[name].id)
    others = {"cartpole": 195, "cartpole_15": 195, "cliffwalking": -25, "pendulum": -250}
    others["taxi"] = 7
    assert node.score_threshold == others.get(name, spec.reward_threshold)
    limits = {"cliffwalking": 500, "deep_sea": 10, "catch": 10}
    assert node.max_steps == limits.get(name, spec.max_episode_steps)
    assert node.score_window == 100
    assert lane_env(make_env(**arguments(name))).max_steps == node.max_steps


@pytest.mark.parametrize(
    "name", ["cliffwalking", "frozenlake", "frozenlake8x8", "river_swim", "taxi", "two_rooms"]
)
def test_the_best_policy_passes(name):
    """By backward induction over the time limit: its mean score is above the threshold.

    A mean that luck alone lifts above it says nothing of what was learned. Where the file says
    what the best policy reaches, it is that.
    """
    node = FILES[name]
    env: Any = gym.make(node.id).unwrapped
    moves, value = env.P, np.zeros(env.observation_space.n)
    for _ in range(node.max_steps):
        value = np.array([
            max(
                sum(p * (r + (0.0 if ended else value[after])) for p, after, r, ended in outcomes)
                for outcomes in moves[state].values()
            )
            for state in range(len(value))
        ])  # fmt: skip
    best = float(env.initial_state_distrib @ value)
    assert best > node.score_threshold
    said = re.search(r"best policy reaches ([\d.]+)", (CONF / f"{name}.yaml").read_text())
    assert (said is None) == (name == "cliffwalking")
    assert said is None or float(said[1]) == round(best, 2)


def test_along_the_cliff_is_the_shortest_path():
    env = make_env(**arguments("cliffwalking"))
    path = iter([0, *[1] * 11, 2])  # up, right, down
    td = env.rollout(20, lambda td: td.set("action", torch.tensor([next(path)])))
    assert td["next", "episode_reward"][0, -1].item() == -13 > FILES["cliffwalking"].score_threshold
    assert td["next", "terminated"][0, -1].item()


@pytest.mark.parametrize("name", [name for name in FILES if name not in BOX2D])
def test_which_have_kernels(name):
    env = lane_env(make_env(**arguments(name))).envs[0]
    try:
        kernel = kernel_of(env)
    except LookupError:
        assert name not in COMPILED
    else:
        assert name in COMPILED
        assert (kernel.n_features, kernel.n_actions) == FEATURES[name]


# The command line


def job(name: str, tmp_path: Path, *overrides: str) -> list[str]:
    small = ["trials=2", "max_iterations=2", "env.max_steps=20", f"output_dir={tmp_path}"]
    needed = ["policy=gaussian_linear", "strategy=gaussian"] if name in CONTINUOUS else []
    return [f"env={name}", *small, *needed, *overrides]


def test_every_file_trains(run_many, tmp_path):
    names = [name for name in FILES if name not in BOX2D or find_spec("Box2D")]
    collectors = ("auto", "torchrl")
    commands = [
        (name, collector)
        for name in names
        for collector in (collectors if name in COMPILED else collectors[:1])
    ]
    ran = run_many(
        [job(name, tmp_path / c, f"collector={c}") for name, c in commands], cwd=tmp_path
    )
    for (name, _), result in zip(commands, ran, strict=True):
        assert result.returncode == 0, (name, result.stderr)
    seen = []
    for path in (tmp_path / "auto").glob("*/*/run.json"):
        run = json.loads(path.read_text(encoding="utf-8"))
        name = next(n for n in names if FILES[n].id == run["config"]["env"]["id"])
        used = "FusedCollector" if name in COMPILED else "SteppingCollector"
        assert run["collector"] == used, name
        seen.append(run["config"]["score_threshold"])
    assert sorted(seen) == sorted(FILES[name].score_threshold for name in names)


def test_any_other_id(run_many, tmp_path):
    """Its threshold is gymnasium's, or must be set; that used is what the results record."""
    any_id = [
        "env=gym", "trials=2", "max_iterations=2", "env.max_steps=30", f"output_dir={tmp_path}",
    ]  # fmt: skip
    acrobot = [*any_id, "env.id=Acrobot-v1"]
    free = [*any_id, "env.id=CliffWalking-v1"]
    ran = run_many(
        [acrobot, acrobot, free, [*free, "score_threshold=-30"], any_id, [*any_id, "env.id=No-v0"]],
        cwd=tmp_path,
    )
    assert [result.returncode for result in ran] == [0, 0, 1, 0, 1, 1]
    assert "restart=true" in ran[1].stdout
    for result, words in zip(
        (ran[2], ran[4], ran[5]),
        ("score_threshold=.*'CliffWalking-v1'", r"env\.id", "'No-v0'"),
        strict=True,
    ):
        assert re.fullmatch(f"error: .*{words}.*\n", result.stderr)
    used = {
        config["env"]["id"]: config["score_threshold"]
        for path in tmp_path.glob("*/*/run.json")
        for config in [json.loads(path.read_text(encoding="utf-8"))["config"]]
    }
    assert used == {"Acrobot-v1": -100, "CliffWalking-v1": -30}


def test_a_module_named_with_the_id_is_imported(tmp_path, monkeypatch):
    module = tmp_path / "registers_an_environment.py"
    module.write_text(
        "import gymnasium as gym\n"
        "gym.register('Registered-v0', entry_point=__name__ + ':no', reward_threshold=7)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert reward_threshold("registers_an_environment:Registered-v0") == 7.0
    with pytest.raises(ValueError, match="'absent_module:No-v0'"):
        reward_threshold("absent_module:No-v0")
    module.with_name("broken_module.py").write_text("raise OSError('no disk')")
    with pytest.raises(ValueError, match=r"broken_module.*OSError: no disk"):
        reward_threshold("broken_module:No-v0")


def test_the_registered_thresholds():
    assert reward_threshold("FrozenLake8x8-v1") == 0.85
    assert reward_threshold("Pendulum-v1") is None
    with pytest.raises(ValueError, match="'No-v0'"):
        reward_threshold("No-v0")


def test_the_number_of_processes_is_not_part_of_a_job(run_many, tmp_path):
    """Lanes in other processes: the same files, and the same job."""
    one, two = (
        [
            "env=gym", "env.id=CartPole-v1", "trials=3", "max_iterations=2", "score_threshold=50",
            "collector=torchrl", f"env.workers={workers}", f"output_dir={tmp_path}",
        ]
        for workers in (1, 2)
    )  # fmt: skip
    first, again, anew = run_many([one, two, [*two, "restart=true"]], cwd=tmp_path)
    assert first.returncode == again.returncode == anew.returncode == 0
    assert "restart=true" in again.stdout
    assert len(list(tmp_path.glob("*/*/run.json"))) == 1
