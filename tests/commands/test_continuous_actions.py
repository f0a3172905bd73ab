"""Every continuous strategy with every Gaussian policy on the command line."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from tests.continuous import STRATEGIES
from trl_explore.config.checking import options

POLICIES = options("policy", "continuous")


@pytest.fixture(scope="module")
def ran(tmp_path_factory, run_many):
    """Every strategy with every policy, and what is refused; by name."""
    place = tmp_path_factory.mktemp("continuous")
    common = ["trials=2", "max_iterations=3", "score_window=2", "score_threshold=1e6"]
    pendulum = [*common, "env=pendulum", "env.max_steps=8"]
    commands = {
        f"{policy} {strategy}": [*pendulum, f"policy={policy}", f"strategy={strategy}"]
        for policy in POLICIES
        for strategy in STRATEGIES
    }
    gaussian = ["policy=gaussian_linear", "strategy=gaussian"]
    car = [*common, "env=gym", "env.id=MountainCarContinuous-v0", "env.max_steps=8"]
    commands |= {
        "car": [*car, *gaussian, "policy.state_dependent_scale=true", "policy.initial_scale=0.5"],
        "per trial": [*pendulum, *gaussian, "strategy.temperature=[0.5,2]"],
        "everything": [
            *pendulum, *gaussian, "evaluate_every=1", "diagnostics=true", "correction=per_step",
            "loss.entropy_coeff=0.01",
        ],
        "behaviour": [*pendulum, *gaussian, "correction=behaviour", "strategy.temperature=1.5"],
        "discrete strategy": [*pendulum, "policy=gaussian_linear"],
        "discrete policy": [*pendulum, "strategy=gaussian"],
        "discrete both": pendulum,
        "continuous both": [*common, *gaussian],
        "no density": [
            *pendulum, "policy=gaussian_linear", "strategy=mean_action", "correction=per_step",
        ],
        "fused": [*pendulum, *gaussian, "collector=fused"],
        "zero scale": [*pendulum, *gaussian, "policy.initial_scale=0"],
        "cold": [*pendulum, *gaussian, "strategy.temperature=0"],
    }  # fmt: skip
    folders = {name: place / name.replace(" ", "_") for name in commands}
    runs = run_many(
        [[*command, f"output_dir={folders[name]}"] for name, command in commands.items()], place
    )
    return {name: (run, folders[name]) for name, run in zip(commands, runs, strict=True)}


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("policy", POLICIES)
def test_every_strategy_with_every_policy(ran, policy, strategy):
    run, folder = ran[f"{policy} {strategy}"]
    assert run.returncode == 0, run.stderr
    (job,) = (folder / "train").iterdir()
    assert job.name.startswith(strategy)
    assert json.loads((job / "run.json").read_text())["collector"] == "SteppingCollector"
    rows = (job / "episodes.csv").read_text().splitlines()
    assert len(rows) == 1 + 2 * 3


@pytest.mark.parametrize("name", ["car", "per trial", "everything", "behaviour"])
def test_combinations(ran, name):
    run, _ = ran[name]
    assert run.returncode == 0, run.stderr


STRATEGY = "strategy=epsilon_mean|epsilon_uniform|gaussian|mean_action|uniform_action"
POLICY = "policy=gaussian_linear|gaussian_mlp"


@pytest.mark.parametrize(
    ("name", "line"),
    [
        (
            "discrete strategy",
            f"continuous ... Softmax; ... {STRATEGY}",
        ),
        (
            "discrete policy",
            f"continuous ... LinearPolicy; ... {POLICY}",
        ),
        (
            "discrete both",
            f"continuous ... Softmax and LinearPolicy; ... {STRATEGY}, {POLICY}",
        ),
        ("continuous both", "discrete ... Gaussian and GaussianLinearPolicy"),
        ("no density", "loss: PerStep ... MeanAction"),
        ("fused", "collector: "),
        ("zero scale", "policy: initial_scale ... 0"),
        ("cold", "strategy: temperature ... > 0 ... 0"),
    ],
)
def test_what_cannot_be_is_one_line(ran, name, line):
    run, _ = ran[name]
    assert run.returncode == 1
    (error,) = run.stderr.splitlines()
    assert re.match("error: .*" + ".*".join(map(re.escape, line.split(" ... "))), error)


def test_diagnostics_of_an_on_policy_run(ran):
    import pandas as pd

    _, folder = ran["everything"]
    (job,) = (folder / "train").iterdir()
    table = pd.read_csv(job / "episodes.csv")
    assert len(table) == 6
    np.testing.assert_allclose(table["ratio_mean"], 1, rtol=1e-4)
    np.testing.assert_allclose(table["effective_sample_size"], 1, rtol=1e-4)
    np.testing.assert_allclose(table["kl"], 0, atol=1e-5)
    assert (table["exploratory"] == 1).all()
    # 1/2 log(2 pi e) at scale 1, before the first update
    np.testing.assert_allclose(
        table["entropy_policy"][table["iteration"] == 1], 1.4189385, rtol=1e-5
    )
