"""The names of jobs."""

from __future__ import annotations

from pathlib import Path

import pytest
from hydra import compose
from omegaconf.errors import InterpolationResolutionError

from tests.config.composed import name
from trl_explore.config import (
    INERT,
)

pytestmark = pytest.mark.usefixtures("hydra")


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
        ("+env.attributes.masscart", ["5", "5.0"]),
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


@pytest.mark.parametrize(
    ("word", "got"),
    [("null", "an empty value"), ("' '", "an empty value"), ("[a]", r"\['a'\]"), ("{a:1}", "{'a'")],
)
def test_output_dir_is_one_folder(word, got):
    config = compose("train", overrides=[f"output_dir={word}"], return_hydra_config=True)
    with pytest.raises(InterpolationResolutionError, match=f"name of a folder, got {got}"):
        config.hydra.sweep.dir  # noqa: B018


def test_output_dir_may_be_a_number():
    config = compose("train", overrides=["output_dir=0"], return_hydra_config=True)
    assert config.hydra.sweep.dir == str(Path("0/train").absolute())


def test_names_are_names_of_one_folder():
    for overrides in (("env=gym", "env.id=ALE/Pong-v5"), ("env=gym", "env.id='a b\\c:d'")):
        assert Path(name(*overrides)).name == name(*overrides)
        assert set(name(*overrides)).isdisjoint(set('/\\:*?"<>| \n'))


def test_a_long_name_is_short_and_still_its_own():
    lists = [",".join(f"0.{k}" for k in range(n)) for n in (100, 101, 48)]
    names = [name("strategy=epsilon_greedy", f"strategy.epsilon=[{values}]") for values in lists]
    assert len(set(names)) == 3
    assert all(len(n) <= 200 and n.startswith("epsilon_greedy,epsilon=") for n in names)
    assert names[0] == name("strategy=epsilon_greedy", f"strategy.epsilon=[{lists[0]}]")
