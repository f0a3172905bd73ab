"""Continuous actions from end to end: collecting, losses, learning, the command line."""

from __future__ import annotations

import json
import re
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from hydra.utils import instantiate
from omegaconf import OmegaConf
from scipy import stats
from tensordict.nn import TensorDictSequential
from torch.distributions import Independent, Normal
from torchrl.envs.utils import ExplorationType
from torchrl.modules import IndependentNormal, ProbabilisticActor

from trl_explore.collectors import FusedCollector, NotCompilableError, TorchRLCollector
from trl_explore.config import CONF
from trl_explore.config.checking import options
from trl_explore.envs import make_env
from trl_explore.numerics.streams import Stream, generator
from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.baselines import LeaveOneOut
from trl_explore.objectives.corrections import Behaviour, PerStep
from trl_explore.policies import GaussianLinearPolicy, GaussianMLPPolicy, LinearPolicy
from trl_explore.policies.actor import actor_of
from trl_explore.strategies import (
    EpsilonMean,
    EpsilonUniform,
    Gaussian,
    MeanAction,
    Softmax,
    UniformAction,
)
from trl_explore.training.evaluation import acting
from trl_explore.training.optimizers import LaneAdam
from trl_explore.training.record import Trials
from trl_explore.training.trainer import Trainer

STRATEGIES = options("strategy", "continuous")
POLICIES = options("policy", "continuous")
BOTH = [GaussianLinearPolicy, GaussianMLPPolicy]


class Target(gym.Env):
    """In every step, reach (x, 1/2) from the observation x; the reward is − distance²."""

    observation_space = spaces.Box(-1, 1, (1,), np.float32)
    action_space = spaces.Box(-2, 2, (2,), np.float32)

    def reset(self, *, seed=None, options=None):
        return self.new(), {}

    def new(self):
        self.x = self.np_random.uniform(-1, 1, 1).astype(np.float32)
        return self.x

    def step(self, action):
        assert self.action_space.contains(action)
        distance = action - np.array([self.x[0], 0.5])
        return self.new(), -float((distance**2).sum()), False, False, {}


@pytest.fixture(autouse=True)
def _target():
    torch.set_num_threads(1)
    gym.register("Target-v0", entry_point=Target, max_episode_steps=10)
    yield
    del gym.registry["Target-v0"]


def strategy_of(name):
    return instantiate(OmegaConf.load(CONF / "strategy" / f"{name}.yaml"), _convert_="all")


def collector_of(strategy, policy=GaussianLinearPolicy, trials=3, first_trial=0, **wanted):
    max_steps = wanted.pop("max_steps", 30)
    streams = {"seed": 2, "first_trial": first_trial}
    env = make_env("Pendulum-v1", trials, max_steps, **streams)
    built = policy(env, **streams, **wanted)
    return TorchRLCollector(env, TensorDictSequential(built, strategy))


def trainer_of(
    strategy, policy, trials, first_trial=0, *, id="Target-v0", steps=None, iterations=5, k=2,
    correction=None, gamma=0.0,
) -> Trainer:  # fmt: skip
    streams = {"seed": 2, "first_trial": first_trial}
    env = make_env(id, trials, steps, **streams)
    built = policy(env, **streams)
    return Trainer(
        TorchRLCollector(env, TensorDictSequential(built, strategy), episodes_per_update=k),
        ReinforceLoss(
            actor_of(built), gamma=gamma, weight=1.0, trials=trials, functional=False,
            baseline=LeaveOneOut(), correction=correction, strategy=strategy,
        ),
        LaneAdam(built.parameters(), lr=0.05),
        Trials(trials, max_iterations=iterations, score_threshold=1e9, score_window=5),
    )  # fmt: skip


# Collecting


@pytest.mark.parametrize("name", STRATEGIES)
@pytest.mark.parametrize("policy", BOTH)
def test_frames(name, policy):
    strategy = strategy_of(name)
    collector = collector_of(strategy, policy)
    data = collector.collect(np.array([True, False, True])).frames
    assert data["action"].shape == (60, 1)
    assert data["action"].dtype == torch.float32
    assert data["trial"].tolist() == [0] * 30 + [2] * 30
    assert ("action_log_prob" in data) == strategy.exact
    assert strategy.noise_size == 2
    torch.testing.assert_close(
        data["next", "episode_reward"][29], data["next", "reward"][:30].sum(0)
    )


def test_actions_come_from_the_trials_streams():
    collector = collector_of(Gaussian(), initial_scale=0.5)
    data = collector.collect().frames
    written = collector.policy[0](data.clone())
    for k in range(3):
        noise = generator(2, Stream.ACTION, k, 0).random((30, 2))
        mine = data["trial"] == k
        loc, scale = (written[key][mine].detach().double().numpy() for key in ("loc", "scale"))
        expected = stats.norm.ppf(noise[:, :1], loc, scale)
        np.testing.assert_allclose(data["action"][mine], expected, rtol=1e-5, atol=1e-5)
        density = stats.norm.logpdf(data["action"][mine].double(), loc, scale).sum(-1)
        np.testing.assert_allclose(data["action_log_prob"][mine], density, rtol=1e-4, atol=1e-4)


def test_the_environment_clips_and_the_data_do_not():
    data = collector_of(Gaussian(), initial_scale=50.0).collect().frames
    assert data["action"].abs().max() > 20
    # Pendulum's reward has 0.001 u^2, |u| <= 2, beside at most pi^2 + 0.1 * 8^2.
    assert (data["next", "reward"] >= -(np.pi**2 + 6.4 + 0.004) - 1e-3).all()


def test_exploration_off_is_the_mean_action():
    mean = collector_of(MeanAction())
    quiet = collector_of(Gaussian())
    quiet.exploration_type = ExplorationType.DETERMINISTIC
    a, b = mean.collect().frames, quiet.collect().frames
    assert torch.equal(a["action"], b["action"])
    assert torch.equal(a["next", "reward"], b["next", "reward"])
    greedy = collector_of(acting(EpsilonMean(), "greedy")).collect().frames
    assert torch.equal(greedy["action"], a["action"])


def test_strategies_differ_in_nothing_else():
    """Paired: with the same policy, frames that are not uniform have the same noise."""
    gaussian, mixed = (
        collector_of(s, max_steps=1).collect().frames for s in (Gaussian(), EpsilonUniform())
    )
    assert torch.equal(gaussian["observation"], mixed["observation"])
    uniform = torch.tensor([generator(2, Stream.ACTION, k, 0).random(2)[1] < 0.3 for k in range(3)])
    assert torch.equal((gaussian["action"] != mixed["action"]).squeeze(-1), uniform)


def test_the_other_kind_is_refused():
    pendulum, cartpole = make_env("Pendulum-v1", 2), make_env("CartPole-v1", 2)
    with pytest.raises(ValueError, match=r"Softmax.*discrete actions"):
        TorchRLCollector(pendulum, TensorDictSequential(GaussianLinearPolicy(pendulum), Softmax()))
    with pytest.raises(ValueError, match=r"Gaussian.*continuous actions"):
        TorchRLCollector(cartpole, TensorDictSequential(LinearPolicy(cartpole), Gaussian()))
    with pytest.raises(NotCompilableError, match="no kernel is registered"):
        FusedCollector(pendulum, TensorDictSequential(GaussianLinearPolicy(pendulum), Gaussian()))


def test_a_box_without_bounds():
    class Endless(Target):
        action_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)

    gym.register("Endless-v0", entry_point=Endless, max_episode_steps=1)
    env = make_env("Endless-v0", 2)
    policy = GaussianLinearPolicy(env)
    data = TorchRLCollector(env, TensorDictSequential(policy, Gaussian())).collect().frames
    assert data["action"].shape == (2, 2)
    for strategy in (UniformAction(), EpsilonUniform(), EpsilonMean()):
        with pytest.raises(ValueError, match=r"box.*finite"):
            TorchRLCollector(env, TensorDictSequential(policy, strategy))
    del gym.registry["Endless-v0"]


def test_state_of_the_collector():
    first, second = (collector_of(Gaussian([0.5, 1.0, 2.0])) for _ in range(2))
    first.collect()
    second.load_state_dict(first.state_dict())
    assert torch.equal(first.collect().frames["action"], second.collect().frames["action"])


# The loss


def loss_of(policy, **wanted):
    return ReinforceLoss(actor_of(policy), gamma=0.9, weight=2.0, trials=3, **wanted)


def returns_of(data):
    """G of 30 frames for each of three trials, by the definition."""
    reward = data["next", "reward"].reshape(3, 30)
    powers = 0.9 ** torch.arange(30.0)
    return torch.stack([(reward[:, t:] * powers[: 30 - t]).sum(1) for t in range(30)], 1)


@pytest.mark.parametrize("functional", [False, True])
@pytest.mark.parametrize("policy", BOTH)
@pytest.mark.parametrize("dependent", [False, True])
def test_loss_and_gradient_are_those_of_torchs_distributions(policy, functional, dependent):
    collector = collector_of(Gaussian(), policy, state_dependent_scale=dependent)
    built, data = collector.policy[0], collector.collect().frames
    parameters = list(built.parameters())
    out = loss_of(built, functional=functional)(data)
    ours = torch.autograd.grad(out["loss_actor"], parameters)
    written = built(data.clone())
    log_prob = Independent(Normal(written["loc"], written["scale"]), 1).log_prob(data["action"])
    expected = -2 * (returns_of(data) * log_prob.reshape(3, 30)).sum(1)
    torch.testing.assert_close(out["trial_loss"], expected.detach(), rtol=1e-4, atol=1e-3)
    theirs = torch.autograd.grad(expected.sum(), parameters)
    for a, b in zip(ours, theirs, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=2e-3)


def test_loss_under_an_actor_of_torchrl():
    collector = collector_of(Gaussian())
    built, data = collector.policy[0], collector.collect().frames
    theirs = ProbabilisticActor(
        built, in_keys=["loc", "scale"], distribution_class=IndependentNormal
    )
    a = loss_of(built, functional=False)(data)["trial_loss"]
    b = ReinforceLoss(theirs, gamma=0.9, weight=2.0, trials=3, functional=False)(data)["trial_loss"]
    torch.testing.assert_close(a, b)


def test_gradient_of_the_behaviour_policy():
    """log mu at temperature 2 is the log-density of a Gaussian twice as wide."""
    strategy = Gaussian(temperature=2.0)
    collector = collector_of(strategy)
    built, data = collector.policy[0], collector.collect().frames
    loss = loss_of(built, functional=False, correction=Behaviour(), strategy=strategy)
    ours = torch.autograd.grad(loss(data)["loss_actor"], list(built.parameters()))
    written = built(data.clone())
    wide = Independent(Normal(written["loc"], 2 * written["scale"]), 1)
    expected = -2 * (returns_of(data) * wide.log_prob(data["action"]).reshape(3, 30)).sum()
    theirs = torch.autograd.grad(expected, list(built.parameters()))
    for a, b in zip(ours, theirs, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=2e-3)


def test_ratios_are_those_of_scipy():
    strategy = EpsilonUniform(0.3)
    collector = collector_of(strategy)
    built, data = collector.policy[0], collector.collect().frames
    loss = loss_of(built, functional=False, correction=PerStep(), strategy=strategy)
    written = built(data.clone())
    action, loc, scale = (
        x.detach().double().numpy() for x in (data["action"], written["loc"], written["scale"])
    )
    pi = stats.norm.pdf(action, loc, scale)[:, 0]
    mu = 0.7 * pi + 0.3 * stats.uniform.pdf(action, -2, 4)[:, 0]
    expected = returns_of(data).reshape(-1).numpy() * pi / mu
    np.testing.assert_allclose(loss.advantage(data), expected, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("strategy", [MeanAction(), EpsilonMean()])
@pytest.mark.parametrize("correction", [PerStep(), Behaviour()])
def test_corrections_that_do_not_exist(strategy, correction):
    built = collector_of(strategy).policy[0]
    with pytest.raises(ValueError, match=f"{type(strategy).__name__}"):
        loss_of(built, correction=correction, strategy=strategy)


# Trials


@pytest.mark.parametrize("name", STRATEGIES)
@pytest.mark.parametrize("policy", BOTH)
def test_a_trial_of_a_batch_is_the_trial_alone(name, policy):
    def run(trials, first_trial=0):
        trainer = trainer_of(
            strategy_of(name), policy, trials, first_trial, id="Pendulum-v1", steps=25, gamma=0.99
        )
        trainer.run()
        return trainer

    batch = run(6)
    for k in (0, 2, 5):
        alone = run(1, k)
        for a, b in zip(batch.optimizer.parameters, alone.optimizer.parameters, strict=True):
            assert torch.equal(a[k], b[0])
        episodes, own = batch.trials.episodes(), alone.trials.episodes()
        assert episodes["score"][episodes["trial"] == k].tolist() == own["score"].tolist()


# Learning


def first_and_last(trainer):
    """Mean reward of the first and of the last 20 episodes of every trial."""
    trainer.run()
    episodes = trainer.trials.episodes()
    trials = len(trainer.trials)
    scores = np.stack([episodes["score"][episodes["trial"] == k] for k in range(trials)])
    return scores[:, :20].mean(1) / 10, scores[:, -20:].mean(1) / 10


@pytest.mark.parametrize("policy", BOTH)
def test_a_gaussian_policy_learns_to_reach_the_target(policy):
    first, last = first_and_last(trainer_of(Gaussian(), policy, 4, iterations=80))
    assert (first < -1).all()
    assert (last > -0.3).all()


def test_importance_weights_make_exploration_unbiased():
    """Uncorrected, uniform frames pull the mean and widen the scale; the ratio mends that."""
    build = partial(trainer_of, EpsilonUniform(), GaussianLinearPolicy, 4, iterations=60)
    _, biased = first_and_last(build())
    first, last = first_and_last(build(correction=PerStep()))
    assert (last > first + 0.5).all()
    assert (last > biased + 1).all()


# The command line


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
