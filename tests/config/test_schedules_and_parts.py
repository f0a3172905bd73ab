"""Parts that have a schedule or a strategy of their own."""

from __future__ import annotations

import re

import pytest

from tests.config.composed import composed, name
from trl_explore.config import (
    CONF,
    ConfigError,
    build_shards,
    build_trainer,
    check_keys,
    job_name,
)
from trl_explore.config.checking import options

pytestmark = pytest.mark.usefixtures("hydra")

SCHEDULES = sorted(path.stem for path in (CONF / "schedule").glob("*.yaml"))
COSINE = "+schedule@strategy.epsilon=cosine"


@pytest.mark.parametrize("schedule", SCHEDULES)
def test_every_schedule_moves_a_parameter(schedule):
    config, choices = composed(
        "strategy=epsilon_greedy", f"+schedule@strategy.epsilon={schedule}", "trials=2"
    )
    check_keys(config, choices)
    epsilon = build_trainer(config).collector.strategy.schedules["epsilon"]
    name, _, clock = schedule.partition("_")
    assert (type(epsilon).__name__.lower(), epsilon.clock) == (name, clock or "iterations")
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
    refused = {}
    for option in options("strategy", "discrete"):
        job = ["correction=as_if", f"strategy@correction.strategy={option}", "trials=2"]
        config, choices = composed(*job)
        check_keys(config, choices)
        try:
            build_trainer(config).close()
        except ConfigError as error:
            refused[option] = str(error)
    assert refused.keys() == {"count_bonus", "epsilon_z_greedy", "parameter_noise", "vdbe"}
    for message in refused.values():
        assert "follow from logits and iteration alone" in message


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
