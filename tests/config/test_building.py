"""Every file of ``conf/`` builds, and what is built follows the configuration."""

from __future__ import annotations

import itertools
import subprocess
import sys
from contextlib import closing

import numpy as np
import pytest
from hydra import compose
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from torchrl.envs.utils import ExplorationType

from tests.config.composed import composed
from trl_explore.collectors import FusedCollector
from trl_explore.config import (
    CONF,
    GROUPS,
    build_shards,
    build_trainer,
    check_keys,
    job_name,
    resolved,
)
from trl_explore.config.building import STOPPING
from trl_explore.config.checking import options
from trl_explore.envs import make_env
from trl_explore.numerics.streams import Stream

pytestmark = pytest.mark.usefixtures("hydra")

EXPERIMENTS = sorted(path.stem for path in (CONF / "experiment").glob("*.yaml"))
FILES = [(group, path.stem) for group in GROUPS for path in sorted((CONF / group).glob("*.yaml"))]
MANDATORY = {
    ("env", "gym"): ["env.id=Acrobot-v1", "env.max_steps=20"],
    ("policy", "tabular"): ["env=gym", "env.id=FrozenLake-v1"],
}
PENDULUM = ["env=pendulum", "env.max_steps=20"]
GAUSSIAN = ["policy=gaussian_linear", "strategy=gaussian"]
MANDATORY["env", "torchrl"] = [
    "env.target=torchrl.envs.PendulumEnv", "env.max_steps=9", "score_threshold=0", *GAUSSIAN,
]  # fmt: skip
MANDATORY |= {
    ("env", name): [*GAUSSIAN, "env.max_steps=20"]
    for name in ("bipedalwalker", "bipedalwalker_hardcore", "pendulum")
}
MANDATORY |= {
    ("policy", name): [*PENDULUM, "strategy=gaussian"] for name in options("policy", "continuous")
}
MANDATORY |= {
    ("strategy", name): [*PENDULUM, "policy=gaussian_linear"]
    for name in options("strategy", "continuous")
}


def test_every_folder_of_conf_is_a_group():
    folders = {path.name for path in CONF.iterdir() if path.is_dir()}
    assert folders - {"hydra"} == {*GROUPS, "experiment", "schedule"}


@pytest.mark.parametrize(("group", "option"), FILES)
def test_every_file_of_every_group_builds(group, option):
    overrides = [f"{group}={option}", "trials=2", *MANDATORY.get((group, option), [])]
    config, choices = composed(*overrides)
    assert choices[group] == option
    check_keys(config, choices)
    resolved(config)
    trainer = build_trainer(config)
    assert len(trainer.trials) == trainer.collector.trials == 2
    data = trainer.collector.collect().frames
    assert data["next", "done"].sum() == 2
    trainer.collector.shutdown()


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_every_experiment_builds(experiment):
    config = compose("train", overrides=[f"experiment={experiment}"], return_hydra_config=True)
    assert config.hydra.runtime.choices.experiment == experiment
    params = config.hydra.sweeper.params or {}
    keys, values = list(params), [str(params[key]).split(",") for key in params]
    names = set()
    for point in itertools.product(*values):
        overrides = [f"{key}={value}" for key, value in zip(keys, point, strict=True)]
        job, choices = composed(f"experiment={experiment}", *overrides)
        check_keys(job, choices)
        job.trials = 1
        build_trainer(job)
        names.add(job_name(job, choices))
    assert len(names) == len(list(itertools.product(*values)))


def sweep(experiment: str) -> tuple[DictConfig, dict[str, str]]:
    config = compose("train", overrides=[f"experiment={experiment}"], return_hydra_config=True)
    return config, dict(config.hydra.sweeper.params)


def test_the_experiments_are_those_of_the_thesis():
    thesis, params = sweep("thesis")
    assert thesis.hydra.mode.name == "MULTIRUN"
    assert (thesis.trials, thesis.max_iterations) == (30, 1000)
    assert set(params) == {"strategy"}
    assert set(params["strategy"].split(",")) == {
        "random", "argmax", "epsilon_greedy", "decaying_epsilon_greedy", "softmax",
    }  # fmt: skip
    assert (thesis.score_threshold, thesis.score_window) == (195.0, 100)
    assert (thesis.loss.gamma, thesis.optimizer.lr) == (0.99, 0.05)
    assert (thesis.env.id, thesis.env.max_steps) == ("CartPole-v1", 500)

    grid, params = sweep("epsilon_grid")
    assert (grid.trials, grid.max_iterations, grid.hydra.mode.name) == (20, 1000, "MULTIRUN")
    assert grid.hydra.runtime.choices.strategy == "epsilon_greedy"
    epsilons = [float(value) for value in params["strategy.epsilon"].split(",")]
    assert epsilons == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]

    grid, params = sweep("decay_grid")
    assert (grid.trials, grid.max_iterations, grid.hydra.mode.name) == (20, 5000, "MULTIRUN")
    assert grid.hydra.runtime.choices.strategy == "decaying_epsilon_greedy"
    decays = [float(value) for value in params["strategy.decay"].split(",")]
    assert decays == [0.9, 0.95, 0.97, 0.98, 0.99, 0.995, 0.999]


def test_the_defaults():
    config, choices = composed()
    assert (config.trials, config.first_trial, config.seed) == (30, 0, 0)
    assert (config.max_iterations, config.score_threshold, config.score_window) == (1000, 195, 100)
    assert (choices["strategy"], choices["env"]) == ("softmax", "cartpole")
    assert config.strategy.temperature == 1.0
    assert composed("strategy=epsilon_greedy")[0].strategy.epsilon == 0.3
    assert composed("strategy=decaying_epsilon_greedy")[0].strategy.decay == 0.99
    # The thesis multiplies the loss with the learning rate (appendix A.3).
    assert composed("optimizer.lr=0.2")[0].loss.weight == 0.2


def test_wrappers_and_transforms_are_built_and_recorded():
    config, _ = composed(
        "trials=2",
        "env.wrappers=[{_target_: gymnasium.wrappers.TimeAwareObservation}]",
        "env.transforms=[{_target_: torchrl.envs.CatFrames, N: 3, dim: -1, in_keys: [observation]},"
        "{_target_: torchrl.envs.RewardScaling, loc: 0, scale: 0.5}]",
    )
    trainer = build_trainer(config)
    frames = trainer.collector.collect().frames
    assert frames["observation"].shape[1] == 15
    assert (frames["next", "reward"] == 0.5).all()
    last = frames["next", "done"].squeeze(-1)
    assert (frames["next", "episode_reward"][last] == frames["next", "step_count"][last]).all()
    recorded = resolved(config)["env"]
    assert recorded["transforms"][1]["scale"] == 0.5
    assert recorded["wrappers"] == [{"_target_": "gymnasium.wrappers.TimeAwareObservation"}]


def test_an_environment_that_its_user_constructs_gets_its_own_keys_only():
    """Not those that ``train.yaml`` gives every environment."""
    config, _ = composed()
    own = {"_target_": "trl_explore.envs.make_env", "id": "CartPole-v1", "max_steps": 9}
    config.env = own | {key: config.env[key] for key in STOPPING}
    assert build_trainer(config).collector.lanes.max_steps == 9


def test_what_is_built_follows_the_configuration():
    config, _ = composed(
        "trials=3", "seed=4", "first_trial=6", "max_iterations=77", "score_window=5",
        "score_threshold=12", "env.max_steps=33", "loss.gamma=0.5", "loss.weight=2",
        "baseline.value=1", "optimizer.lr=0.25", "strategy=epsilon_greedy", "strategy.epsilon=0.7",
    )  # fmt: skip
    trainer = build_trainer(config)
    trials, lanes, loss = trainer.trials, trainer.collector.lanes, trainer.loss
    assert (len(trials), trials.max_iterations, trials.score_window) == (3, 77, 5)
    assert trials.score_threshold == 12.0
    assert (lanes.id, lanes.num_envs, lanes.max_steps) == ("CartPole-v1", 3, 33)
    assert (lanes.seed, lanes.first_trial) == (4, 6)
    assert (loss.gamma, loss.weight, loss.baseline.value, loss.trials) == (0.5, 2.0, 1.0, 3)
    assert trainer.optimizer.lr == 0.25
    assert trainer.collector.strategy.mixture().uniform == 0.7
    policy = trainer.collector.policy[0]
    assert trainer.optimizer.parameters[0] is policy.weight
    again = build_trainer(composed("trials=1", "seed=4", "first_trial=8")[0])
    assert (policy.weight[2] == again.collector.policy[0].weight[0]).all()


def test_a_second_job_shares_no_object_with_the_first():
    words = ["trials=2", "+env.kwargs.render_mode=null", "env.max_steps=9"]
    first, second = (build_trainer(composed(*words)[0]) for _ in range(2))
    first.run()
    assert second.trials.iteration == 0
    for name, value in first.parts.items():
        assert second.parts[name] is not value
    assert first.collector.strategy is not second.collector.strategy
    changed = build_trainer(composed(*words, "env.max_steps=8", "loss.gamma=0.5")[0])
    assert (changed.collector.lanes.max_steps, changed.loss.gamma) == (8, 0.5)


def test_one_line_says_which_collector_all_shards_use(monkeypatch, caplog):
    """Also where it cannot use several threads, so that shards are put together again."""
    from trl_explore.training import shards

    monkeypatch.setattr(shards, "SMALLEST", 2)
    for strategy, parts in (("softmax", 2), ("count_bonus", 1)):
        caplog.clear()
        with caplog.at_level("INFO", "trl_explore"):
            built = build_shards(composed(f"strategy={strategy}", "trials=4", "threads=2")[0])
        assert len(built.trainers) == parts
        assert len(caplog.messages) == 1
        built.close()


def test_importing_the_module_imports_no_torch():
    code = "import sys, trl_explore.config; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_strategies_know_every_argument_by_their_yaml():
    """A mistyped override fails when the configuration is composed: no key is optional."""
    for path in sorted((CONF / "strategy").glob("*.yaml")):
        keys = set(OmegaConf.load(path)) - {"_target_"}
        config, _ = composed(f"strategy={path.stem}")
        assert set(config.strategy) - {"_target_"} == keys
        with pytest.raises((HydraException, OmegaConfBaseException)):
            composed(f"strategy={path.stem}", "strategy.nonsense=1")


@pytest.mark.parametrize(("workers", "processes"), [("null", 2), ("1", 1), ("3", 3)])
def test_workers_are_processes_and_null_is_one_per_processor(workers, processes, monkeypatch):
    monkeypatch.setattr("trl_explore.envs.processes.processors", lambda: 2)
    overrides = ("collector=stepping", "evaluate_every=0", f"env.workers={workers}")
    with closing(build_trainer(composed(*overrides)[0])) as trainer:
        assert trainer.collector.lanes.workers == processes


@pytest.mark.parametrize("collector", ["fused", "torchrl"])
def test_evaluations_share_the_environment_of_the_training_and_play_their_own_stream(collector):
    """The same episodes as with an environment of the evaluations' own."""
    config, _ = composed(f"collector={collector}", "trials=2", "max_iterations=3", "seed=5")
    with closing(build_trainer(config)) as trainer:
        trainer.run()
        shared = trainer.evaluator.collector
        assert shared.env is trainer.collector.env
        env = make_env("CartPole-v1", 2, seed=5, stream=Stream.EVALUATION)
        options = {"exploration_type": ExplorationType.DETERMINISTIC}
        own = FusedCollector(env, shared.policy, **options)
        played = [c.play(np.array([0, 1, 1]), np.array([4, 9, 2])) for c in (shared, own)]
        for got, wanted in zip(*played, strict=True):
            np.testing.assert_array_equal(got, wanted)
        same = FusedCollector(trainer.collector.env, shared.policy, **options)
        assert (same.play(np.array([0, 1, 1]), np.array([4, 9, 2]))[0] != played[0][0]).any()


def test_trainers_that_share_an_environment_keep_their_trials():
    config, _ = composed("trials=3", "max_iterations=3")
    first = build_trainer(config, slice(0, 1))
    second = build_trainer(config, slice(2, 3), first.collector.env)
    assert second.collector.env is first.collector.env
    alone = build_trainer(config, slice(0, 1)).run()
    assert first.run().frames.tolist() == alone.frames.tolist()
    assert second.run().frames.tolist() == build_trainer(config).run().frames[2:].tolist()
