"""What is refused, in one line."""

from __future__ import annotations

import re

import pytest
from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from tests.config.composed import composed
from trl_explore.config import (
    ConfigError,
    build_trainer,
    check_keys,
    describe,
    differences,
    resolved,
)

TORCHRL = ["env.target=torchrl.envs.PendulumEnv", "env.max_steps=9", "score_threshold=0"]
pytestmark = pytest.mark.usefixtures("hydra")


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
    (("env.kwargs=3",), "env.kwargs must map names to values ... got 3"),
    (("env.attributes=1",), "env.attributes must map names to values ... got 1"),
    (("env.workers=0",), "env: workers ... >= 1 ... 0"),
    (("env.workers=true",), "env: workers ... True"),
    (("optimizer=torch", "optimizer.options=3"), "optimizer: options must map names ... got 3"),
    (("optimizer=torch", "optimizer.name=[SGD]"), "optimizer: name must be one of ... ['SGD']"),
    (
        ("optimizer=torch", "+optimizer.options.momentum=x"),
        "optimizer: SGD rejects its options {'momentum': 'x'}: ",
    ),
    (
        ("optimizer=torch", "optimizer.name=Adam", "+optimizer.options.betas=[0.9]"),
        "optimizer: Adam rejects its options {'betas': [0.9]}: ",
    ),
    (("collector._target_=null",), "collector: ... got 'None'"),
    (("loss._target_=nothing.at.all",), "loss: Error loading 'nothing.at.all'"),
    (("+env.kwargs.nonsense=1",), "nonsense"),
    (("env=gym", "env.id=FrozenLake-v1", "+env.kwargs.map_name=no"), "'no'"),
]


@pytest.mark.parametrize(("overrides", "message"), WRONG, ids=[" ".join(w[0]) for w in WRONG])
def test_wrong_values_are_one_line(overrides, message, caplog):
    with pytest.raises(ConfigError) as error:
        build_trainer(composed(*overrides)[0])
    assert re.search(".*".join(map(re.escape, message.split(" ... "))), str(error.value))
    assert "\n" not in str(error.value)
    assert not [record for record in caplog.records if record.levelname == "ERROR"]


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
