from __future__ import annotations

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from tensordict import TensorDict
from torch.optim import Adam

from trl_explore.config import CONF
from trl_explore.config.checking import options
from trl_explore.objectives import ReinforceLoss
from trl_explore.policies import initial_weights
from trl_explore.strategies import Argmax, DecayingEpsilonGreedy, EpsilonGreedy, Softmax
from trl_explore.training.optimizers import LaneAdam, LaneOptimizer, torch_optimizer

FILES = [CONF / "strategy" / f"{name}.yaml" for name in options("strategy", "discrete")]


def weights(trainer) -> torch.Tensor:
    (parameter,) = trainer.optimizer.parameters
    return parameter.detach()


def history(trainer, trial: int) -> list[tuple[float, int]]:
    """Score and frames of every episode of one trial."""
    episodes = trainer.trials.episodes()
    rows = episodes["trial"] == trial
    return list(zip(episodes["score"][rows], episodes["frames"][rows], strict=True))


def assert_same_trial(one, k: int, two, j: int) -> None:
    """Trial k of one run is trial j of the other, bit for bit."""
    assert torch.equal(weights(one)[k], weights(two)[j])
    for name in ("iterations", "score", "frames", "status"):
        assert getattr(one.trials, name)[k] == getattr(two.trials, name)[j], name
    assert history(one, k) == history(two, j)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_trial_of_a_batch_is_the_trial_alone(file, train):
    run = partial(train, max_iterations=8, score_window=3, score_threshold=22.0, max_steps=100)
    strategy = partial(instantiate, OmegaConf.load(file))
    batch = run(strategy(), trials=6, seed=3)
    for k in (0, 2, 5):
        assert_same_trial(run(strategy(), trials=1, first_trial=k, seed=3), 0, batch, k)


def test_trials_that_stop_early_disturb_nobody(train):
    """Softmax trials that converge in different iterations, against each of them alone."""
    run = partial(train, max_iterations=15, score_window=4, score_threshold=35.0)
    batch = run(Softmax(), trials=12)
    assert len(set(batch.trials.iterations)) >= 3  # whatever the seed
    tail = run(Softmax(), trials=9, first_trial=3)
    for k in range(0, 12, 2):
        assert_same_trial(run(Softmax(), trials=1, first_trial=k), 0, batch, k)
    for k in range(9):
        assert_same_trial(tail, k, batch, k + 3)


def tensors(optimizer) -> list[torch.Tensor]:
    """Weights and both moments, each with the trials as dimension 0."""
    if isinstance(optimizer, LaneOptimizer):
        return optimizer.rows()
    state = [*optimizer.exp_avg, *optimizer.exp_avg_sq]
    return [*(parameter.detach() for parameter in optimizer.parameters), *state]


@pytest.mark.parametrize("optimizer", [LaneAdam, partial(torch_optimizer, name="Adam")])
def test_a_stopped_trial_does_not_move(optimizer, build):
    """Neither its weights nor the state of Adam, from the iteration in which it stops."""
    seen: list[tuple[np.ndarray, list[torch.Tensor]]] = []

    def look(trials) -> None:
        rows = [tensor.clone() for tensor in tensors(trainer.optimizer)]
        seen.append((trials.active.copy(), rows))

    trainer = build(
        Softmax(),
        5,
        max_iterations=25,
        score_window=5,
        score_threshold=35.0,
        on_iteration=look,
        optimizer=optimizer,
    )
    trainer.run()
    checked = 0
    for (active, before), (_, after) in pairwise(seen):
        assert len(before) == 3  # weights and two moments
        for one, two in zip(before, after, strict=True):
            assert torch.equal(one[~active], two[~active])
            assert (one[active] != two[active]).flatten(1).any(1).all()
        checked += int((~active).sum())
    assert checked > 10
    assert trainer.trials.active.sum() == 0


def test_two_runs_are_identical(train):
    runs = [train(EpsilonGreedy(0.3), 3, seed=6, max_iterations=6) for _ in range(2)]
    for k in range(3):
        assert_same_trial(runs[0], k, runs[1], k)


def test_the_global_generators_do_not_matter(train):
    runs = []
    for seed in (1, 2):
        torch.manual_seed(seed)
        np.random.seed(seed)  # noqa: NPY002 - nothing may draw from it
        state = torch.get_rng_state(), np.random.get_state()[1].copy()  # noqa: NPY002
        runs.append(train(Softmax(), 2, max_iterations=4))
        assert torch.equal(torch.get_rng_state(), state[0])
        assert (np.random.get_state()[1] == state[1]).all()  # noqa: NPY002
    for k in range(2):
        assert_same_trial(runs[0], k, runs[1], k)


def test_different_seeds_share_no_trial(train):
    runs = [train(Softmax(), 4, seed=seed, max_iterations=3) for seed in range(4)]
    rows = torch.cat([weights(run) for run in runs]).flatten(1)
    assert len(rows.unique(dim=0)) == 16
    starts = torch.cat([initial_weights([4, 2], 4, seed=seed)[0] for seed in range(4)]).flatten(1)
    assert len(starts.unique(dim=0)) == 16


def test_strategies_are_compared_on_paired_trials(build):
    """The same trial starts from the same weights and in the same state, whatever explores."""
    one, two = (build(strategy, 3, seed=1) for strategy in (Softmax(), EpsilonGreedy(0.3)))
    assert torch.equal(weights(one), weights(two))
    starts = [t.collector.collect().frames for t in (one, two)]
    first = [data["observation"][data["next", "step_count"][:, 0] == 1] for data in starts]
    assert torch.equal(*first)


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_a_broken_trial_stops_and_its_neighbours_never_notice(value, build, train):
    run = {"trials": 4, "max_iterations": 9, "score_window": 5, "score_threshold": 1e9}

    def breakage(trials) -> None:
        if trials.iteration == 3:
            with torch.no_grad():
                weights(broken)[2, 1, 0] = value

    broken = build(Softmax(), **run, on_iteration=breakage)
    broken.run()
    sound = train(Softmax(), **run)
    assert broken.trials.status.tolist() == ["capped", "capped", "diverged", "capped"]
    assert broken.trials.iterations.tolist() == [9, 9, 4, 9]
    assert not broken.trials.converged.any()
    assert history(broken, 2)[:3] == history(sound, 2)[:3]
    for k in (0, 1, 3):
        assert_same_trial(broken, k, sound, k)


class Breaking(Adam):
    """Writes a value into one weight of trial 1 in its third step."""

    value = torch.nan

    def step(self, closure=None):
        super().step(closure)
        (parameter,) = self.param_groups[0]["params"]
        if self.state[parameter]["step"] == 3:
            with torch.no_grad():
                parameter[1] = self.value


@pytest.mark.parametrize(
    ("value", "status", "iterations"),
    [(torch.nan, "diverged", 3), (torch.inf, "diverged", 3), (3e38, "capped", 3)],
)
def test_a_trial_stops_in_the_iteration_in_which_its_weights_break(
    value, status, iterations, train, monkeypatch
):
    monkeypatch.setattr(Breaking, "value", value)
    breaking = partial(LaneOptimizer, partial(Breaking, lr=0.01, foreach=False))
    trainer = train(Argmax(), 3, max_iterations=3, optimizer=breaking)
    assert trainer.trials.status.tolist() == ["capped", status, "capped"]
    assert trainer.trials.iterations.tolist() == [3, iterations, 3]


class BrokenLoss(ReinforceLoss):
    """Finite gradients, and a loss of trial 0 that is not finite."""

    def forward(self, tensordict: TensorDict) -> TensorDict:
        losses = super().forward(tensordict)
        losses["trial_loss"][0] = torch.inf
        return losses


def test_a_trial_stops_when_its_loss_is_not_finite(train):
    trainer = train(Softmax(), 2, max_iterations=3, loss=BrokenLoss)
    assert trainer.trials.status.tolist() == ["diverged", "capped"]
    assert trainer.trials.iterations.tolist() == [1, 3]


def test_schedules_advance_once_for_each_iteration(build):
    """Whatever the number of frames, and also while trials stop."""
    strategy, epsilons = DecayingEpsilonGreedy(0.9), []
    trainer = build(strategy, 3, max_iterations=6, score_window=2, score_threshold=20.0)
    collect = trainer.collector.collect

    def watch(active):
        epsilons.append(float(strategy.mixture().uniform))
        return collect(active)

    trainer.collector.collect = watch
    trainer.run()
    assert len(epsilons) == trainer.trials.iteration
    assert epsilons == pytest.approx([0.9**i for i in range(len(epsilons))], abs=0)


def test_updates_by_hand(build):
    """The weights after each iteration follow Adam along the written-out gradient."""
    lr, gamma, trials = 0.05, 0.9, 3
    trainer = build(Softmax(), trials, gamma=gamma, lr=lr, max_iterations=4, seed=4)
    collect, seen = trainer.collector.collect, []
    expected = weights(trainer).clone().double().requires_grad_()
    adam = Adam([expected], lr=lr)

    def watch(active):
        rollout = collect(active)
        seen.append(rollout.frames.clone())
        return rollout

    def compare(record) -> None:
        data, loss = seen[-1], torch.zeros((), dtype=torch.float64)
        for k in range(trials):
            mine = data[data["trial"] == k]
            rewards, n = mine["next", "reward"][:, 0].double(), len(mine)
            log_pi = (mine["observation"].double() @ expected[k].t()).log_softmax(-1)
            for t in range(n):
                future = sum(gamma ** (j - t) * rewards[j] for j in range(t, n))
                loss = loss - lr * future * log_pi[t, mine["action"][t]]
            assert history(trainer, k)[-1] == (float(n), n)
        adam.zero_grad()
        loss.backward()
        adam.step()
        torch.testing.assert_close(
            weights(trainer).double(), expected.detach(), rtol=1e-4, atol=1e-5
        )

    trainer.collector.collect = watch
    trainer.on_iteration = compare
    trainer.run()
    assert len(seen) == 4


def test_every_episode_after_an_update_is_collected_with_the_new_weights(build):
    trainer = build(Softmax(), 2, max_iterations=5, score_threshold=1e9)
    collect, seen = trainer.collector.collect, []

    def watch(active):
        before = weights(trainer).clone()
        rollout = collect(active)
        data = rollout.frames
        log_pi = (before[data["trial"]] @ data["observation"].unsqueeze(-1))[..., 0].log_softmax(-1)
        expected = log_pi.gather(1, data["action"].unsqueeze(1))[:, 0]
        torch.testing.assert_close(data["action_log_prob"], expected, rtol=1e-4, atol=1e-5)
        seen.append(before)
        return rollout

    trainer.collector.collect = watch
    trainer.run()
    assert len(torch.stack(seen).flatten(1).unique(dim=0)) == 5


def test_lane_adam_trains_like_torch_adam(train):
    """The same episodes, and the same weights up to rounding."""
    one, two = (
        train(EpsilonGreedy(0.3), 3, max_iterations=8, optimizer=optimizer)
        for optimizer in (LaneAdam, partial(torch_optimizer, name="Adam"))
    )
    for k in range(3):
        assert history(one, k) == history(two, k)
    torch.testing.assert_close(weights(one), weights(two), rtol=1e-4, atol=1e-5)


def test_losses_of_one_trial_each_train_like_their_sum(train):
    def none(*args, **kwargs):
        return ReinforceLoss(*args, **kwargs, reduction="none")

    one, two = train(Softmax(), 3), train(Softmax(), 3, loss=none)
    for k in range(3):
        assert_same_trial(one, k, two, k)


def test_a_mean_over_trials_is_refused(build):
    def mean(*args, **kwargs):
        return ReinforceLoss(*args, **kwargs, reduction="mean")

    with pytest.raises(ValueError, match=r"reduction.*'mean'.*trials"):
        build(Softmax(), loss=mean)


def test_on_iteration_and_seconds(train):
    calls = []
    trainer = train(
        Softmax(),
        3,
        max_iterations=5,
        score_window=2,
        score_threshold=20.0,
        on_iteration=lambda trials: calls.append(trials.iteration),
    )
    trials = trainer.trials
    assert calls == list(range(1, trials.iteration + 1))
    assert (trials.seconds > 0).all()
    order = np.argsort(trials.iterations, kind="stable")
    assert (np.diff(trials.seconds[order]) >= 0).all()


def test_the_weights_move_by_the_optimiser_alone(train):
    trainer = train(Softmax(), 1, max_iterations=1, optimizer=partial(LaneAdam, lr=1e-3))
    moved = weights(trainer) - initial_weights([4, 2], 1)[0]
    torch.testing.assert_close(moved.abs(), torch.full_like(moved, 1e-3), rtol=1e-2, atol=0)
