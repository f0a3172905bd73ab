from __future__ import annotations

import itertools
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from trl_explore import config as configuration
from trl_explore.config import (
    CONF,
    GROUPS,
    INERT,
    ConfigError,
    build_shards,
    build_trainer,
    check_keys,
    describe,
    differences,
    job_name,
    resolved,
)
from trl_explore.config.building import STOPPING
from trl_explore.config.checking import options

EXPERIMENTS = sorted(path.stem for path in (CONF / "experiment").glob("*.yaml"))
FILES = [(group, path.stem) for group in GROUPS for path in sorted((CONF / group).glob("*.yaml"))]
MANDATORY = {
    ("env", "gym"): ["env.id=Acrobot-v1", "env.max_steps=20"],
    ("policy", "tabular"): ["env=gym", "env.id=FrozenLake-v1"],
}
TORCHRL = ["env.target=torchrl.envs.PendulumEnv", "env.max_steps=9", "score_threshold=0"]
PENDULUM = ["env=pendulum", "env.max_steps=20"]
GAUSSIAN = ["policy=gaussian_linear", "strategy=gaussian"]
MANDATORY["env", "torchrl"] = [*TORCHRL, *GAUSSIAN]
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


@pytest.fixture(scope="module", autouse=True)
def hydra():
    configuration.register_resolvers()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        yield


def composed(*overrides: str) -> tuple[DictConfig, dict[str, Any]]:
    """The configuration of a job as ``scripts/train.py`` gets it, and the choices of its groups."""
    config = compose("train", overrides=list(overrides), return_hydra_config=True)
    choices = dict(config.hydra.runtime.choices)
    with open_dict(config):
        config.pop("hydra")
    return config, choices


def name(*overrides: str) -> str:
    config, choices = composed(*overrides)
    return job_name(config, choices)


# Files


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


# Names


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        ((), "softmax,temperature=1.0"),
        (("strategy=argmax",), "argmax"),
        (("strategy.temperature=0.5",), "softmax,temperature=0.5"),
        (("strategy=epsilon_greedy", "strategy.epsilon=0.1"), "epsilon_greedy,epsilon=0.1"),
        (("strategy=epsilon_greedy", "strategy.epsilon=0.3"), "epsilon_greedy,epsilon=0.3"),
        (("strategy=epsilon_greedy",), "epsilon_greedy,epsilon=0.3"),
        (("strategy=argmax", "seed=3"), "argmax,seed=3"),
        (("seed=3",), "softmax,temperature=1.0,seed=3"),
        (("strategy=argmax", "trials=30", "seed=0"), "argmax"),
        (("strategy=argmax", "collector=torchrl"), "argmax,collector=torchrl"),
        (("strategy=argmax", "loss.gamma=0.9", "seed=1"), "argmax,loss.gamma=0.9,seed=1"),
        (("strategy=argmax", "optimizer.lr=0.1"), "argmax,optimizer.lr=0.1"),
        (("strategy=argmax", "env=gym", "env.id=Acrobot-v1"), "argmax,env=gym,env.id=Acrobot-v1"),
    ],
)
def test_names_of_jobs(overrides, expected):
    assert name(*overrides) == expected


@pytest.mark.parametrize(
    ("key", "spellings"),
    [
        ("strategy.temperature", ["1", "1.0", "1e0", "1.00", "+1.0"]),
        ("strategy.temperature", ["2", "2.0", "2e0", "20e-1"]),
        ("optimizer.lr", ["0.1", "0.10", "1e-1", ".1"]),
        ("score_threshold", ["195", "195.0"]),
        ("score_threshold", ["100", "100.0"]),
        ("strategy.temperature", ["[1,2]", "[1, 2]"]),
    ],
)
def test_one_value_has_one_name_however_it_is_spelt(key, spellings):
    assert len({name(f"{key}={spelling}") for spelling in spellings}) == 1


def test_different_values_never_share_a_name():
    overrides = [
        (),
        ("strategy=argmax",),
        ("strategy=random",),
        ("strategy=epsilon_greedy",),
        ("strategy=epsilon_greedy", "strategy.epsilon=0.1"),
        ("strategy=epsilon_greedy", "strategy.epsilon=0.1000001"),
        ("strategy=epsilon_greedy", "strategy.epsilon=[0.1]"),
        ("strategy=epsilon_greedy", "strategy.epsilon=[0.1,0.2]"),
        ("strategy=epsilon_greedy", "strategy.epsilon=[0.1,0.3]"),
        ("strategy=decaying_epsilon_greedy",),
        ("strategy=decaying_epsilon_greedy", "strategy.decay=0.9"),
        *((f"strategy.temperature={t}",) for t in (0, 0.5, 5, 1e-5, 1e5, "null", "x")),
        *((f"seed={seed}",) for seed in (1, 2, 11, "1.5", "true", "null")),
        *((f"trials={trials}",) for trials in (1, 2, 29, 300)),
        *((f"first_trial={first}",) for first in (1, 7)),
        ("first_trial=1", "trials=1"),
        ("first_trial=1", "seed=1"),
        *((f"max_iterations={cap}",) for cap in (10, 100)),
        *((f"score_threshold={threshold}",) for threshold in (10, 10.5)),
        *((f"score_window={window}",) for window in (10, 11)),
        *((f"loss.gamma={gamma}",) for gamma in (0, 0.9, 1)),
        *((f"optimizer.lr={lr}",) for lr in (0.01, 0.1)),
        ("optimizer.lr=0.1", "loss.weight=0.05"),
        ("loss.weight=0.1",),
        ("baseline.value=1",),
        ("loss.reduction=none",),
        ("env.max_steps=200",),
        ("env.max_steps=null",),
        ("env.id=Acrobot-v1",),
        ("env=gym", "env.id=CartPole-v1"),
        ("env=gym", "env.id=Acrobot-v1"),
        ("env=gym", "env.id=ALE/Pong-v5"),
        ("env=gym", "env.id=ALE-Pong-v5"),
        ("env=gym", "env.id=ALE%2FPong-v5"),
        *(
            ("env=gym", "env.id=FrozenLake-v1", f"+env.kwargs.{argument}")
            for argument in (
                "is_slippery=false",
                "is_slippery=true",
                "map_name=8x8",
                "map_name=null",
            )
        ),
        ("env=gym", "env.id=FrozenLake-v1"),
        ("collector=torchrl",),
    ]
    names = [name(*entry) for entry in overrides]
    shared = {n: [o for o, m in zip(overrides, names, strict=True) if m == n] for n in names}
    assert {n: entries for n, entries in shared.items() if len(entries) > 1} == {}


@pytest.mark.parametrize(
    "override",
    [
        "output_dir=elsewhere",
        "restart=true",
        "threads=2",
        "episodes=false",
        "debug=true",
        "checkpoint_seconds=9",
        "env.workers=2",
    ],
)
def test_what_changes_no_result_is_not_in_the_name(override):
    assert override.split("=")[0] in INERT
    assert name("strategy=argmax", override) == "argmax"


def test_the_name_depends_on_the_experiment_through_its_folder_only():
    debug = ["experiment=debug", "strategy=argmax"]
    assert name(*debug) == "argmax"
    assert name(*debug, "trials=4") == "argmax,trials=4"
    assert name(*debug, "trials=30") == "argmax,trials=30"
    config = compose("train", overrides=debug, return_hydra_config=True)
    assert config.hydra.run.dir == str(Path("outputs/debug/argmax").absolute())
    assert config.hydra.sweep.dir == str(Path("outputs/debug").absolute())
    assert config.hydra.sweep.subdir == "argmax"
    plain = compose("train", overrides=["strategy=argmax"], return_hydra_config=True)
    assert plain.hydra.run.dir == str(Path("outputs/train/argmax").absolute())


def test_names_are_names_of_one_folder():
    for overrides in (("env=gym", "env.id=ALE/Pong-v5"), ("env=gym", "env.id='a b\\c:d'")):
        assert Path(name(*overrides)).name == name(*overrides)
        assert set(name(*overrides)).isdisjoint(set('/\\:*?"<>| \n'))


def test_a_long_name_is_short_and_still_its_own():
    lists = [",".join(f"0.{k}" for k in range(n)) for n in (100, 101)]
    names = [name("strategy=epsilon_greedy", f"strategy.epsilon=[{values}]") for values in lists]
    assert names[0] != names[1]
    assert all(len(n) < 255 and n.startswith("epsilon_greedy,epsilon=") for n in names)
    assert names[0] == name("strategy=epsilon_greedy", f"strategy.epsilon=[{lists[0]}]")


# Checks


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("+foo=1", r"'foo'.*seed.*trials"),
        ("+strategy.epsilon=0.1", r"'strategy\.epsilon'.*strategy=softmax.*temperature"),
        ("+loss.gama=1", r"'loss\.gama'.*loss=reinforce.*gamma"),
        ("+env.steps=1", r"'env\.steps'.*env=cartpole.*max_steps"),
        ("+optimizer.betas=[0,0]", r"'optimizer\.betas'.*optimizer=adam.*lr"),
        ("+policy.bias=true", r"'policy\.bias'.*policy=linear.*init"),
    ],
)
def test_keys_that_do_not_exist(override, message):
    config, choices = composed(override)
    with pytest.raises(ConfigError, match=message) as error:
        check_keys(config, choices)
    assert "\n" not in str(error.value)


SCHEDULES = sorted(path.stem for path in (CONF / "schedule").glob("*.yaml"))
COSINE = "+schedule@strategy.epsilon=cosine"


@pytest.mark.parametrize("schedule", SCHEDULES)
def test_every_schedule_serves_a_parameter(schedule):
    config, choices = composed(
        "strategy=epsilon_greedy", f"+schedule@strategy.epsilon={schedule}", "trials=2"
    )
    check_keys(config, choices)
    epsilon = build_trainer(config).collector.strategy.schedules["epsilon"]
    assert type(epsilon).__name__.lower() == schedule
    assert epsilon(0) == 1.0
    assert job_name(config, choices).startswith(f"epsilon_greedy,epsilon={schedule},epsilon.")


def test_names_of_schedules():
    linear = ("strategy=softmax", "+schedule@strategy.temperature=linear")
    values = "temperature.final=0.1,temperature.initial=5.0,temperature.iterations=500"
    assert name(*linear, "strategy.temperature.initial=5") == f"softmax,temperature=linear,{values}"
    cosine = (linear[0], linear[1].replace("linear", "cosine"))
    names = [
        name(*choice, f"strategy.temperature.initial={initial}")
        for choice in (linear, cosine)
        for initial in (1, 2.5)
    ]
    assert len({*names, name("strategy=softmax"), name("strategy=boltzmann")}) == 6
    exponential = "boltzmann,temperature.decay=0.99,temperature.initial=5.0"
    assert name("strategy=boltzmann") == exponential


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["strategy=epsilon_greedy", COSINE, "+strategy.epsilon.decay=1"],
            "'strategy.epsilon.decay' ... final, initial, iterations",
        ),
        (
            ["strategy=boltzmann", "+strategy.temperature.final=1"],
            "'strategy.temperature.final' ... decay, initial",
        ),
        (
            ["strategy=boltzmann", "+schedule@strategy.temperature=linear"],
            "'strategy.temperature.decay' ... final, initial, iterations ... strategy=boltzmann",
        ),
        ([COSINE], "'strategy.epsilon' ... strategy=softmax ... temperature"),
        (
            ["+schedule@optimizer.lr=linear"],
            "+schedule@strategy.NAME= ... 'optimizer.lr'",
        ),
        (["+schedule=linear"], "'schedule'"),
    ],
)
def test_schedules_where_there_are_none(overrides, message):
    with pytest.raises(ConfigError, match=r".*".join(map(re.escape, message.split(" ... ")))):
        check_keys(*composed(*overrides))


def test_a_parameter_that_takes_no_schedule():
    overrides = ("strategy=decaying_epsilon_greedy", "+schedule@strategy.decay=linear")
    config, choices = composed(*overrides)
    check_keys(config, choices)
    with pytest.raises(ConfigError, match=r"strategy: decay.*\[0, 1\].*Lin"):
        build_trainer(config)


AS_IF = ("correction=as_if", "strategy@correction.strategy=softmax")


def test_the_bias_of_any_discrete_strategy():
    assert name("correction=as_if") == (
        "softmax,correction=as_if,correction.strategy=epsilon_greedy,temperature=1.0,"
        "correction.strategy.epsilon=0.3"
    )
    assert name(*AS_IF, "correction.strategy.temperature=2").endswith(".temperature=2.0")
    accepted = []
    for option in options("strategy", "discrete"):
        job = ["correction=as_if", f"strategy@correction.strategy={option}", "trials=2"]
        config, choices = composed(*job)
        check_keys(config, choices)
        try:
            build_trainer(config).close()
            accepted.append(option)
        except ConfigError as error:
            assert "follow from logits and iteration alone" in str(error)  # noqa: PT017
    refused = {"count_bonus", "epsilon_z_greedy", "parameter_noise", "vdbe"}
    assert set(accepted) == {*options("strategy", "discrete")} - refused


def test_the_bias_of_a_strategy_whose_parameter_has_a_schedule():
    schedule = "+schedule@correction.strategy.temperature=linear"
    config, choices = composed(*AS_IF, schedule, "trials=2")
    check_keys(config, choices)
    trainer = build_trainer(config)
    assert trainer.loss.correction.strategy.schedules["temperature"](0) == 1.0
    assert trainer.loss.correction.strategy.schedules["temperature"](10**6) == 0.1


def test_per_trial_values_of_the_assumed_strategy_reach_their_shards():
    job = ["correction=as_if", "correction.strategy.epsilon=[0.1,0.2,0.3]", "trials=3"]
    shards = build_shards(composed(*job)[0], sizes=[2, 1])
    found = [t.loss.correction.strategy.epsilon.tolist() for t in shards.trainers]
    assert found == [[0.1, 0.2], [0.3]]
    with pytest.raises(ConfigError, match="correction: epsilon has 3 values, but there are 2"):
        build_shards(composed(*job[:2], "trials=2")[0])


def test_arguments_of_an_environment_are_free():
    check_keys(*composed("env=gym", "env.id=FrozenLake-v1", "+env.kwargs.is_slippery=false"))


def test_a_mandatory_value():
    with pytest.raises(ConfigError, match=r"env\.id.*env\.id="):
        resolved(composed("env=gym")[0])


def test_an_interpolation_that_fails():
    with pytest.raises(ConfigError, match="nowhere") as error:
        resolved(composed("seed=${nowhere}")[0])
    assert "\n" not in str(error.value)


WRONG = [
    (("trials=0",), "trials ... >= 1 ... 0"),
    (("trials=2.5",), "trials ... >= 1 ... 2.5"),
    (("trials=many",), "trials ... >= 1 ... 'many'"),
    (("seed=-1",), "seed ... >= 0 ... -1"),
    (("seed=true",), "seed ... >= 0 ... True"),
    (("first_trial=-1",), "first_trial ... >= 0 ... -1"),
    (("threads=0",), "threads ... >= 1 ... 0"),
    (("max_iterations=0",), "max_iterations ... >= 1 ... 0"),
    (("score_window=0",), "score_window ... >= 1 ... 0"),
    (("score_threshold=nan",), "score_threshold ... finite ... nan"),
    (("evaluate_every=-1",), "evaluate_every ... >= 0 ... -1"),
    (("evaluate_every=often",), "evaluate_every ... auto or an integer ... 'often'"),
    (("evaluate_every=2.5",), "evaluate_every ... 2.5"),
    (("evaluate_episodes=3", "evaluate_every=0"), "evaluate_episodes=3 ... evaluate_every ... 0"),
    (("evaluate_episodes=0",), "evaluate_episodes ... >= 1 ... 0"),
    (
        ("evaluate_episodes=2", "env=pendulum", "policy=gaussian_linear", "strategy=gaussian"),
        "evaluate_episodes=2 needs evaluations ... auto ... integer >= 1",
    ),
    (("keep_weights=10",), "keep_weights ... list ... [0,10,50] ... 10"),
    (("keep_weights=[5,11]", "max_iterations=10"), "keep_weights ... <= 10 ... 11"),
    (("evaluate_confirm=19",), "evaluate_confirm ... >= 20 ... 19"),
    (("evaluate_policy=random",), "evaluate_policy ... greedy, sampled ... 'random'"),
    (("stop_on=score",), "stop_on ... training, learned, both, never ... 'score'"),
    (("stop_on=learned", "evaluate_every=0"), "stop_on=learned needs evaluations"),
    (
        ("stop_on=both", "env=pendulum", "policy=gaussian_linear", "strategy=gaussian"),
        "stop_on=both needs evaluations: evaluate_every=auto ... or a number",
    ),
    (("strategy.temperature=0",), "strategy: temperature ... > 0 ... 0"),
    (("strategy.temperature=-1",), "strategy: temperature ... > 0 ... -1"),
    (("strategy.temperature=nan",), "strategy: temperature ... > 0 ... nan"),
    (("strategy.temperature=inf",), "strategy: temperature ... > 0 ... inf"),
    (("strategy.temperature=hot",), "strategy: temperature ... > 0 ... 'hot'"),
    *(
        (
            ("strategy=epsilon_greedy", f"strategy.epsilon={value}"),
            f"strategy: epsilon ... in [0, 1] ... {value}",
        )
        for value in ("1.5", "-0.1", "nan")
    ),
    (
        ("strategy=epsilon_greedy", "strategy.epsilon=[0.1,0.2,0.3]", "trials=2"),
        "3 values ... 2 trials",
    ),
    (("strategy=epsilon_greedy", "strategy.epsilon=[0.1,2]", "trials=2"), "in [0, 1] ... 2"),
    (
        ("strategy=decaying_epsilon_greedy", "strategy.decay=1.1"),
        "strategy: decay ... in [0, 1] ... 1.1",
    ),
    (("optimizer.lr=-0.1",), "optimizer: lr ... > 0 ... -0.1"),
    (("optimizer.lr=0",), "optimizer: lr ... > 0 ... 0"),
    (("loss.gamma=1.01",), "loss: gamma ... in [0, 1] ... 1.01"),
    (("loss.gamma=nan",), "loss: gamma ... in [0, 1] ... nan"),
    (("loss.reduction=mean",), "loss: reduction ... 'mean' ... trials"),
    (("loss.reduction=max",), "loss: reduction ... sum, mean, none ... 'max'"),
    (("env.max_steps=0",), "env: max_steps ... >= 1 ... 0"),
    (("env.id=NoSuch-v0",), "env: ... 'NoSuch-v0'"),
    (("env.id=Pendulum-v1",), "continuous actions ... Softmax and LinearPolicy"),
    (("env.wrappers=3",), "env.wrappers must be a list, env.wrappers=[{_target_: ... got 3"),
    (("env.wrappers=[3]",), "env.wrappers[0] must name a class ... got 3"),
    (("env.transforms=[{a: 1}]",), "env.transforms[0] must name a class ... {'a': 1}"),
    (("env.transforms=[{_target_: torchrl.envs.No}]",), "env: ... torchrl.envs.No"),
    (("env.wrappers=[{_target_: gymnasium.wrappers.No}]",), "env: ... gymnasium.wrappers.No"),
    (
        ("env.wrappers=[{_target_: gymnasium.wrappers.TimeLimit}]",),
        "env: the wrapper TimeLimit ... 'CartPole-v1' ... max_episode_steps",
    ),
    (
        ("env.wrappers=[{_target_: builtins.id}]",),
        "env: the wrapper id makes a int, not a gymnasium.Env",
    ),
    (
        ("env.transforms=[{_target_: torchrl.envs.VecNormV2, in_keys: [observation]}]",),
        "env: the transform VecNormV2 mixes trials",
    ),
    (("+env.attributes.masscart=5",), "env: ... computed total_mass from masscart"),
    (("env=torchrl", "env.target=no.Env", *TORCHRL[1:]), "env: there is no class 'no.Env'"),
    (
        ("env.id=CliffWalking-v1", "env.max_steps=null"),
        "CliffWalking-v1 ... max_steps",
    ),
    (("env.id=3",), "env.id must be the name of an environment, e.g. env.id=Acrobot-v1, got 3"),
    (("env.id=null",), "env.id must be the name ... got None"),
    (("env=gym", "env.id="), "env.id must be the name ... got ''"),
    (("env.kwargs=3",), "env: "),
    (("+env.kwargs.nonsense=1",), "nonsense"),
    (("env=gym", "env.id=FrozenLake-v1", "+env.kwargs.map_name=no"), "'no'"),
]


@pytest.mark.parametrize(("overrides", "message"), WRONG, ids=[" ".join(w[0]) for w in WRONG])
def test_wrong_values_are_one_line(overrides, message):
    with pytest.raises(ConfigError) as error:
        build_trainer(composed(*overrides)[0])
    assert re.search(".*".join(map(re.escape, message.split(" ... "))), str(error.value))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("strategy=thompson", "strategy=thompson ... argmax, "),
        ("env=pong", "env=pong ... acrobot, "),
        ("experiment=no", "experiment=no ... baselines, "),
        ("foo=1", "'foo' ... --help"),
        ("strategy.epsilon=1", "'strategy.epsilon' ... --help"),
        ("strategy.temperature=[1", ""),
        ("=", ""),
    ],
)
def test_what_hydra_refuses_is_described_in_one_line(override, message):
    with pytest.raises((HydraException, OmegaConfBaseException)) as error:
        composed(override)
    text = describe(error.value)
    assert re.search(".*".join(map(re.escape, message.split(" ... "))), text)
    assert text
    assert "\n" not in text


def test_errors_of_the_file_system_in_one_line():
    error = PermissionError(13, "Permission denied", "/there")
    assert re.fullmatch("[^\n]*/there[^\n]*Permission denied[^\n]*", describe(error))
    assert describe(ValueError()) == "ValueError"


def test_differences():
    old = {"seed": 0, "env": {"id": "a", "max_steps": 500}, "output_dir": "x", "restart": False}
    assert differences(old, old) == []
    assert differences(old, {**old, "output_dir": "y", "restart": True, "threads": 4}) == []
    assert differences(old, {**old, "seed": 1}) == ["seed: 0 before, 1 now"]
    policy = {**old, "policy": {"lr": 0.05}}  # a default of optimizer.lr, which is compared
    assert differences({**old, "policy": {}}, policy) == []
    assert differences(old, {**old, "seed": 0.0}) == []
    assert differences(old, {**old, "seed": False}) == ["seed: 0 before, False now"]
    assert differences(old, {**old, "env": {"id": "b", "max_steps": 9}}) == [
        "env.id: a before, b now",
        "env.max_steps: 500 before, 9 now",
    ]
    # Within a group the names of the free keys are results' keys again.
    assert differences({"env": {"threads": 1}}, {"env": {"threads": 2}}) == [
        "env.threads: 1 before, 2 now"
    ]


# Building


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


def test_one_line_says_which_collector_serves_all_shards(monkeypatch, caplog):
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
