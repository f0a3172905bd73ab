"""Evaluation must not touch training, and diagnostics must be what they say."""

import math
import time

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential

from trl_explore import config as configuration
from trl_explore.collectors import TorchRLCollector
from trl_explore.config import CONF
from trl_explore.config.building import build_trainer
from trl_explore.config.checking import options
from trl_explore.envs import make_env
from trl_explore.numerics.streams import Stream, generator
from trl_explore.policies import LinearPolicy
from trl_explore.policies.actor import SoftmaxActor
from trl_explore.statistics.evaluations import decide, stages
from trl_explore.strategies import EpsilonGreedy, ParameterNoise
from trl_explore.training.diagnostics import COLUMNS, Diagnostics
from trl_explore.training.evaluation import SCHEDULED


@pytest.fixture(scope="module", autouse=True)
def hydra():
    configuration.register_resolvers()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        yield


def trained(*overrides):
    config = compose(
        "train",
        ["trials=4", "max_iterations=24", "score_window=6", "evaluate_episodes=2", *overrides],
        return_hydra_config=True,
    )  # fmt: skip
    trainer = build_trainer(config)
    trainer.run()
    return trainer


@pytest.mark.parametrize("strategy", options("strategy", "discrete"))
def test_training_is_the_same_evaluated_or_not(strategy):
    """No number of the training depends on evaluations, for any strategy."""
    chosen = [f"strategy={strategy}", "score_threshold=30"]
    plain = trained(*chosen, "evaluate_every=0", "evaluate_episodes=1")
    assert plain.evaluator is None
    for every in ("auto", "7"):
        other = trained(
            *chosen, f"evaluate_every={every}", "evaluate_episodes=3", "diagnostics=true"
        )
        for name, column in plain.trials.episodes().items():
            np.testing.assert_array_equal(column, other.trials.episodes()[name])
        assert torch.equal(plain.collector.policy[0].weight, other.collector.policy[0].weight)
        assert plain.trials.status.tolist() == other.trials.status.tolist()
        np.testing.assert_array_equal(plain.trials.iterations_to_pass, other.trials.iterations)


def test_every_evaluation_is_recorded():
    rows = trained("evaluate_every=7", "score_threshold=501").evaluator.rows()
    scheduled, final = (rows["purpose"] == k for k in (0, 2))
    assert rows["iteration"][scheduled].tolist() == [
        i for i in (0, 7, 14, 21, 24) for _ in range(8)
    ]
    assert rows["trial"][scheduled].tolist() == [0, 0, 1, 1, 2, 2, 3, 3] * 5
    assert rows["trial"][final].tolist() == [t for t in range(4) for _ in range(20)]
    assert (rows["iteration"][final] == 24).all()
    assert not (rows["purpose"] == 1).any()
    assert (rows["score"] >= 1).all()


def test_only_compiled_environments_are_evaluated_unasked():
    assert trained().evaluator is not None
    pendulum = ["env=pendulum", "policy=gaussian_linear", "strategy=gaussian", "trials=1"]
    assert build_trainer(compose("train", pendulum, return_hydra_config=True)).evaluator is None
    asked = compose("train", [*pendulum, "evaluate_every=5"], return_hydra_config=True)
    assert build_trainer(asked).evaluator is not None


def greedy_score(weight, seed, trial, number):
    """The score of argmax(W s) in gymnasium, with the episode's own stream."""
    import gymnasium as gym

    env = gym.make("CartPole-v1").unwrapped
    env.np_random = generator(seed, Stream.EVALUATION, trial, number)
    state, _ = env.reset()
    score, ended = 0, False
    while not ended and score < 500:
        state, _, ended, _, _ = env.step(int(np.argmax(weight @ state)))
        score += 1
    return score


def test_the_learned_score_is_that_of_gymnasium():
    """Recomputed from the final weights with gymnasium and numpy; also every single episode."""
    trainer = trained("seed=5", "first_trial=3")
    rows = trainer.evaluator.rows()
    for trial in range(4):
        weight = trainer.collector.policy[0].weight.detach().numpy()[trial]
        mine = rows["score"][(rows["purpose"] == 2) & (rows["trial"] == trial)]
        numbers = [3 * 2**52 + 24 * 2**21 + j for j in range(20)]
        assert mine.tolist() == [greedy_score(weight, 5, 3 + trial, x) for x in numbers]
        assert trainer.evaluator.learned_score[trial] == mine.mean()
        last = rows["score"][(rows["iteration"] == 24) & (rows["purpose"] == 0)][2 * trial :][:2]
        numbers = [2**52 + 24 * 2**21 + j for j in range(2)]
        assert last.tolist() == [greedy_score(weight, 5, 3 + trial, x) for x in numbers]


def test_an_evaluation_plays_the_weights_of_the_next_training_episode():
    """Iteration i is evaluated after i updates: iteration 0 has the initial weights."""
    trainer = trained("seed=5", "max_iterations=1", "evaluate_every=1")
    initial = build_trainer(
        compose("train", ["trials=4", "seed=5"], return_hydra_config=True)
    ).collector.policy[0]
    rows = trainer.evaluator.rows()
    first = rows["score"][(rows["iteration"] == 0) & (rows["trial"] == 0)]
    weight = initial.weight.detach().numpy()[0]
    assert first.tolist() == [greedy_score(weight, 5, 0, 2**52 + j) for j in range(2)]


def test_an_episode_does_not_depend_on_the_schedule():
    one = trained("evaluate_every=4", "score_threshold=501").evaluator.rows()
    two = trained("evaluate_every=8", "evaluate_episodes=1", "score_threshold=501").evaluator.rows()
    at = (one["iteration"] == 8) & (one["purpose"] == 0)
    other = (two["iteration"] == 8) & (two["purpose"] == 0)
    assert one["score"][at][::2].tolist() == two["score"][other].tolist()
    for rows in (one, two):
        assert (rows["purpose"] == 2).sum() == 80
    np.testing.assert_array_equal(
        one["score"][one["purpose"] == 2], two["score"][two["purpose"] == 2]
    )


def recomputed(rows, trials, threshold, most):
    """The rule, applied by hand to the recorded episodes: learned, and the iteration."""
    found = []
    for trial in range(trials):
        mine = {n: x[rows["trial"] == trial] for n, x in rows.items()}
        lowest, learned, at = np.inf, False, 0
        for i in np.unique(mine["iteration"]):
            here = [
                mine["score"][(mine["iteration"] == i) & (mine["purpose"] == p)] for p in range(3)
            ]
            looked = here[0] if len(here[0]) else here[2]
            for part in here[::2]:
                lowest = min([lowest, *part])
            if learned:
                continue
            at = i
            if i == 0 or looked.mean() <= threshold:
                assert not len(here[1])
                continue
            n = len(here[1])
            assert n in stages(most)
            for stage in stages(most):
                part = here[1][:stage]
                verdict = decide(part[None], np.array([min([lowest, *part])]), threshold, most)[0]
                if verdict != 0:
                    break
            assert stage == n
            lowest = min([lowest, *part])
            learned = verdict == 1
        found.append((bool(learned), int(at)))
    return found


@pytest.mark.parametrize("stop_on", ["training", "never", "both", "learned"])
def test_what_was_learned_follows_from_the_recorded_episodes(stop_on):
    trainer = trained(
        f"stop_on={stop_on}", "score_threshold=45", "trials=12", "max_iterations=60",
        "evaluate_episodes=2",
    )  # fmt: skip
    evaluator, trials = trainer.evaluator, trainer.trials
    found = recomputed(evaluator.rows(), 12, 45, 100)
    assert [x for x, _ in found] == evaluator.learned.tolist()
    assert [x for _, x in found] == evaluator.iterations_to_learn.tolist()
    assert evaluator.learned.any()
    episodes = trials.episodes()
    for trial in range(12):
        until = (episodes["trial"] == trial) & (
            episodes["iteration"] <= evaluator.iterations_to_learn[trial]
        )
        assert episodes["frames"][until].sum() == evaluator.frames_to_learn[trial]
    passed, learned, ended = trials.passed, evaluator.learned, trials.iterations < 60
    assert (passed | (trials.iterations_to_pass == trials.iterations)).all()
    met = {
        "training": passed,
        "never": passed & False,
        "both": passed & learned,
        "learned": learned,
    }
    assert (trials.converged == (trials.status == "converged")).all()
    assert (met[stop_on] | ~ended).all()
    if stop_on in ("learned", "both", "never"):
        assert (trials.converged == met[stop_on]).all()
    if stop_on == "both":
        last = np.maximum(trials.iterations_to_pass, evaluator.iterations_to_learn)
        assert (trials.iterations[met["both"]] == last[met["both"]]).all()


def test_passing_is_recorded_where_it_does_not_stop_a_trial():
    stopped = trained("score_threshold=30", "max_iterations=40")
    on = trained("score_threshold=30", "max_iterations=40", "stop_on=never")
    assert stopped.trials.passed.any()
    np.testing.assert_array_equal(stopped.trials.passed, on.trials.passed)
    np.testing.assert_array_equal(stopped.trials.iterations_to_pass, on.trials.iterations_to_pass)
    np.testing.assert_array_equal(stopped.trials.frames_to_pass, on.trials.frames_to_pass)
    assert (on.trials.status == "capped").all()


def test_sampled_evaluations_play_the_policy_itself():
    greedy, sampled = (
        trained(f"evaluate_policy={name}", "score_threshold=501", "max_iterations=10", "trials=40")
        for name in ("greedy", "sampled")
    )
    rows = [t.evaluator.rows() for t in (greedy, sampled)]
    assert rows[0]["score"].mean() != rows[1]["score"].mean()
    # Weights start near zero: π is near uniform and its episodes are short.
    start = rows[1]["score"][rows[1]["iteration"] == 0]
    assert 15 < start.mean() < 40


def test_diverged_trials_keep_their_last_evaluation():
    evaluator = trained("evaluate_every=5", "score_threshold=501").evaluator
    rows = evaluator.rows()
    evaluator.finish(np.full(4, 24), np.full(4, 999), np.array([True, False, False, False]))
    last = rows["score"][(rows["trial"] == 0) & (rows["iteration"] == 24) & (rows["purpose"] == 0)]
    assert evaluator.learned_score[0] == last.mean()
    assert not ((evaluator.rows()["trial"] == 0) & (evaluator.rows()["purpose"] == 2)).any()
    assert (evaluator.iterations_to_learn[0], evaluator.frames_to_learn[0]) == (24, 999)


def test_a_trial_that_has_diverged_is_not_evaluated():
    overrides = ["trials=2", "max_iterations=4", "evaluate_every=1"]
    trainer = build_trainer(compose("train", overrides, return_hydra_config=True))

    def breakage(trials) -> None:
        if trials.iteration == 2:
            with torch.no_grad():
                trainer.collector.policy[0].weight[0] = torch.nan

    trainer.on_iteration = breakage
    assert trainer.run().status.tolist() == ["diverged", "capped"]
    rows = trainer.evaluator.rows()
    of = rows["purpose"] == SCHEDULED
    assert [rows["iteration"][of & (rows["trial"] == k)].tolist() for k in (0, 1)] == [
        [0, 1, 2], [0, 1, 2, 3, 4],
    ]  # fmt: skip


def test_evaluations_survive_a_checkpoint():
    overrides = ("trials=4", "evaluate_every=3", "diagnostics=true", "max_iterations=9",
                 "score_threshold=20")  # fmt: skip
    config = compose("train", list(overrides), return_hydra_config=True)
    whole, first, second = (build_trainer(config) for _ in range(3))
    whole.run()
    first.run(lambda: first.trials.iteration >= 5)
    for part in (first.history(0, 2), first.history(2)):
        second.load_history(part)
    second.load_state_dict(first.state_dict())
    second.run()
    for name, column in whole.evaluator.rows().items():
        np.testing.assert_array_equal(column, second.evaluator.rows()[name])
    for name in ("learned", "iterations_to_learn", "frames_to_learn", "learned_score"):
        np.testing.assert_array_equal(
            getattr(whole.evaluator, name), getattr(second.evaluator, name)
        )
    for name, column in whole.diagnostics.columns().items():
        np.testing.assert_array_equal(column, second.diagnostics.columns()[name])


def test_evaluating_is_not_time_of_training():
    trainer = trained("evaluate_episodes=500", "max_iterations=3")
    assert trainer.evaluating > 0
    assert trainer.trials.seconds.max() <= trainer.seconds
    started = time.perf_counter()
    again = trained("evaluate_episodes=500", "max_iterations=3")
    assert again.seconds + again.evaluating <= time.perf_counter() - started


def test_diagnostics_by_hand():
    """One trial, π = (1/4, 3/4), μ = ε-greedy at 0.4 = (0.2, 0.8), actions 1, 0, 1, 1."""
    env = make_env("CartPole-v1", trials=1)
    policy = LinearPolicy(env)
    with torch.no_grad():
        policy.weight.zero_()
        policy.weight[0, 1, 0] = math.log(3)
    pi, mu = (0.25, 0.75), (0.2, 0.8)
    action = torch.tensor([1, 0, 1, 1])
    observation = torch.tensor([[1.0, 0, 0, 0]] * 3 + [[1.0, 0.25, 0, 0]])
    done = torch.tensor([[False], [False], [False], [True]])
    data = TensorDict(
        {
            "trial": torch.zeros(4, dtype=torch.int64),
            "observation": observation,
            "action": action,
            "action_log_prob": torch.tensor([mu[a] for a in action]).log(),
            "next": {"reward": torch.ones(4, 1), "done": done},
        },
        [4],
    )
    policy.weight.grad = torch.tensor([[[3.0, 0, 0, 0], [0, 4.0, 0, 0]]])
    diagnostics = Diagnostics(SoftmaxActor(policy), EpsilonGreedy(0.4), 1, policy.parameters())
    diagnostics.record(data, np.ones(1, dtype=np.bool_))
    found = {name: float(column[0]) for name, column in diagnostics.columns().items()}
    ratios = np.array([pi[a] / mu[a] for a in action])
    expected = {
        "entropy_policy": -sum(p * math.log(p) for p in pi),
        "entropy_behaviour": -sum(p * math.log(p) for p in mu),
        "kl": sum(m * math.log(m / p) for m, p in zip(mu, pi, strict=True)),
        "ratio_mean": ratios.mean(),
        "effective_sample_size": ratios.sum() ** 2 / (4 * (ratios**2).sum()),
        "exploratory": 0.25,
        "greedy_share": 1.0,
        "coverage": 2.0,
        "gradient_norm": 5.0,
    }
    assert set(found) == set(COLUMNS)
    assert found == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("episodes", [1, 3])
def test_what_is_said_of_the_behaviour_is_that_of_the_frames(episodes):
    """Under parameter noise μ is known of one episode: of more there is nothing to be said."""
    env = make_env("CartPole-v1", trials=2)
    policy, strategy = LinearPolicy(env), ParameterNoise(sigma=2.0)
    collector = TorchRLCollector(
        env, TensorDictSequential(policy, strategy), episodes_per_update=episodes
    )
    data = collector.collect().frames
    diagnostics = Diagnostics(SoftmaxActor(policy), strategy, 2, policy.parameters())
    diagnostics.record(data, np.ones(2, dtype=np.bool_))
    columns = diagnostics.columns()
    assert np.isfinite(columns["ratio_mean"]).all()
    if episodes > 1:
        assert np.isnan([columns["entropy_behaviour"], columns["kl"]]).all()
        return
    weight = policy.weight.detach().double()
    for k in range(2):
        own = data[data["trial"] == k]
        xi = generator(0, Stream.STRATEGY, k, 0).standard_normal((2, 4))
        x = own["observation"].double()
        log_mu = (x @ (weight[k] + 2 * torch.from_numpy(xi)).T).log_softmax(-1)
        log_pi = (x @ weight[k].T).log_softmax(-1)
        kl = (log_mu.exp() * (log_mu - log_pi)).sum(-1).mean()
        assert columns["kl"][k] == pytest.approx(float(kl), rel=1e-4)
