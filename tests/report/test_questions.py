"""What is compared with what: factors, blocks, confounded factors, pilots and repeats."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from trl_explore.report.evidence import Evidence, gather
from trl_explore.report.loading import load

LINEAR = {"_target_": "trl_explore.policies.LinearPolicy", "init": "glorot_uniform"}
NETWORK = {"_target_": "trl_explore.policies.MLPPolicy", "hidden": [32, 32]}
RATIO = {"_target_": "trl_explore.objectives.corrections.PerStep", "clip": None}
CRITIC = {"_target_": "trl_explore.objectives.baselines.LinearValue", "lr": 0.5}
SOFTMAX, EPSILON = {"temperature": 1.0}, {"epsilon": 0.3}
FAST = [150 + k for k in range(12)]
SLOW = [500 + 7 * k for k in range(12)]


@pytest.fixture
def job(tmp_path: Path, make_job: Any) -> Any:
    """Write a job with parts of its configuration and its overrides."""

    def write(name: str, taken: list[int], *words: str, config: Any = None, **more: Any) -> Path:
        folder = make_job(tmp_path / "train", name, taken, **more)
        (folder / ".hydra" / "overrides.yaml").write_text("".join(f"- {w}\n" for w in words))
        run = json.loads((folder / "run.json").read_text())
        run["config"] |= config or {}
        (folder / "run.json").write_text(json.dumps(run))
        return folder

    return write


def optimizer(lr: float) -> dict[str, Any]:
    return {"_target_": "trl_explore.training.optimizers.LaneAdam", "lr": lr}


def evidence(tmp_path: Path) -> Evidence:
    return gather(load([tmp_path]))


def test_several_factors_at_once_are_confounded_and_the_separating_jobs_are_named(tmp_path, job):
    job("a", SLOW, "strategy=softmax", config={"policy": LINEAR})
    job("b", FAST, "strategy=softmax", "policy=mlp", "correction=per_step", "baseline=linear_value",
        config={"policy": NETWORK, "correction": RATIO, "baseline": CRITIC})  # fmt: skip
    found = evidence(tmp_path)
    (said,) = found.answer
    assert "policy, correction and baseline at once" in said
    assert "`trl-explore train strategy=softmax policy=mlp`" in said
    assert "`trl-explore train strategy=softmax policy=mlp correction=per_step`" in said
    assert found.groups[0].comparisons == []
    assert list(found.groups[0].group.labels.values()) == [
        "linear policy, uncorrected, no baseline", "network, per-step ratio, linear critic",
    ]  # fmt: skip


def test_a_learning_rate_tuned_per_strategy_is_no_effect_of_the_strategy(tmp_path, job):
    for strategy, lr, taken, own in (
        ("softmax", 0.05, FAST, SOFTMAX), ("epsilon_greedy", 0.02, SLOW, EPSILON),
    ):  # fmt: skip
        config = {"optimizer": optimizer(lr), "loss": {"weight": lr}}
        job(strategy, taken, f"strategy={strategy}", f"optimizer.lr={lr}", strategy=strategy,
            parameters=own, config=config)  # fmt: skip
    (said,) = evidence(tmp_path).answer
    assert "differ in strategy and learning rate at once" in said
    assert "fastest" not in said
    assert "`trl-explore train optimizer.lr=0.02 strategy=softmax`" in said


def test_each_factor_is_a_question_within_what_else_is_the_same(tmp_path, job):
    for strategy, own in (("softmax", SOFTMAX), ("epsilon_greedy", EPSILON)):
        for lr in (0.05, 0.01):
            taken = [n * (2 if strategy != "softmax" else 1) for n in FAST]
            job(f"{strategy}{lr}", taken, strategy=strategy, parameters=own,
                config={"optimizer": optimizer(lr)})  # fmt: skip
    found = evidence(tmp_path)
    strategies, rates = found.groups[0].answered
    assert (strategies.question.of, rates.question.of) == ("strategy", "learning rate")
    assert len(strategies.comparisons) == len(rates.comparisons) == 2
    assert found.answer[0].startswith("The effect of strategy: ")


def test_a_configuration_without_a_partner_is_confounded_and_the_others_are_compared(tmp_path, job):
    job("a", FAST, parameters=SOFTMAX, config={"optimizer": optimizer(0.05)})
    job("b", SLOW, strategy="epsilon_greedy", parameters=EPSILON,
        config={"optimizer": optimizer(0.05)})  # fmt: skip
    job("c", SLOW, strategy="argmax", config={"optimizer": optimizer(0.01)})
    effect, confounded = evidence(tmp_path).answer
    assert "softmax is fastest" in effect
    assert "“argmax, learning rate = 0.01” and “ε-greedy, learning rate = 0.05”" in confounded


def test_pilots_are_left_out_and_repeats_are_pooled(tmp_path, job):
    for strategy, own, taken in (
        ("softmax", SOFTMAX, FAST), ("epsilon_greedy", EPSILON, SLOW),
    ):  # fmt: skip
        job(strategy, taken, strategy=strategy, parameters=own)
        job(f"{strategy},seed=1", taken[:6], strategy=strategy, parameters=own, seed=1)
        job(f"{strategy},cap=300", [200, 300], strategy=strategy, parameters=own, cap=300)
    (group,) = evidence(tmp_path).groups
    assert [len(c) for c in group.group.configurations] == [18, 18]
    repeats, pilot = group.group.notes
    assert "seeds 0 (12 trials) and 1 (6 trials) of" in repeats
    assert "with 2 trials and a cap of 300 iterations" in pilot


def test_trials_added_until_decided_are_told_of(tmp_path, job):
    folder = job("softmax", FAST, parameters=SOFTMAX)
    (group,) = evidence(tmp_path).groups
    assert not group.group.notes
    (folder.parent / "settle.json").write_text("{}")
    (group,) = evidence(tmp_path).groups
    assert "are too sure" in group.group.notes[0]


def test_maps_of_one_environment_are_questions_of_their_own(tmp_path, job):
    for slippery in (True, False):
        env = {"id": "FrozenLake-v1", "kwargs": {"is_slippery": slippery}}
        for strategy, taken in (("softmax", FAST), ("argmax", SLOW)):
            job(f"{strategy}{slippery}", taken, strategy=strategy, config={"env": env})
    job("other", FAST, env="Acrobot-v1")
    found = evidence(tmp_path)
    assert [p.group.environment for p in found.groups] == [
        "FrozenLake-v1 (is slippery = True)", "FrozenLake-v1 (is slippery = False)", "Acrobot-v1",
    ] or found.groups[0].size >= found.groups[1].size  # fmt: skip
    assert found.answer[-1].startswith("Not compared")
    assert "Only" not in " ".join(found.answer)


def test_an_option_of_the_user_has_a_readable_name(tmp_path, job):
    job("a", FAST)
    job("b", SLOW, config={"baseline": {"_target_": "mylab.parts.RollingQuantile", "n_steps": 3}})
    labels = evidence(tmp_path).groups[0].group.labels
    assert list(labels.values()) == ["no baseline", "rolling quantile"]
