"""A loss that reads arrays trains with the same bits as one that reads the TensorDict."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf

from trl_explore.collectors import FusedCollector, TorchRLCollector
from trl_explore.config import CONF
from trl_explore.config.checking import options
from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.baselines import EpisodeMean
from trl_explore.objectives.corrections import PerStep
from trl_explore.strategies import BaseStrategy, EpsilonGreedy, Softmax
from trl_explore.strategies.schedules import Linear

IDS = {"CartPole-v1": 500, "Acrobot-v1": 40, "FrozenLake-v1": 40}


class Framewise(ReinforceLoss):
    """The same loss, which reads every iteration's TensorDict."""

    def array_backward(self):
        return None


class Counting(ReinforceLoss):
    """The same loss, which counts the iterations that it read as arrays."""

    count = 0

    def array_backward(self):
        own = super().array_backward()

        def counted(frames):
            type(self).count += 1
            return own(frames)

        return None if own is None else counted


def strategy(name):
    return instantiate(OmegaConf.load(CONF / "strategy" / f"{name}.yaml"))


COMPILABLE = [
    name for name in options("strategy", "discrete") if getattr(strategy(name), "compilable", False)
]


def same(one, two):
    for a, b in zip(one.optimizer.parameters, two.optimizer.parameters, strict=True):
        assert torch.equal(a.detach(), b.detach())
    first, second = one.trials.episodes(), two.trials.episodes()
    assert all(np.array_equal(first[name], second[name]) for name in first)
    for name, buffer in one.collector.strategy.named_buffers():
        assert torch.equal(buffer, two.collector.strategy.get_buffer(name))


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("name", COMPILABLE)
def test_arrays_and_frames_give_the_same_bits(name, id, train):
    run = partial(
        train, trials=5, id=id, max_steps=IDS[id], max_iterations=12, score_threshold=40.0,
        collector=FusedCollector,
    )  # fmt: skip
    Counting.count = 0
    with_arrays = run(strategy(name), loss=partial(Counting, baseline=3.0))
    assert Counting.count == with_arrays.trials.iteration > 3
    same(with_arrays, run(strategy(name), loss=partial(Framewise, baseline=3.0)))


@pytest.mark.parametrize("episodes", [2, 7])
@pytest.mark.parametrize("reduction", ["sum", "none"])
def test_several_episodes_and_every_reduction(episodes, reduction, train):
    run = partial(
        train, trials=3, collector=partial(FusedCollector, episodes_per_update=episodes)
    )  # fmt: skip
    Counting.count = 0
    options = {"reduction": reduction}
    same(
        run(EpsilonGreedy(), loss=partial(Counting, **options)),
        run(EpsilonGreedy(), loss=partial(Framewise, **options)),
    )
    assert Counting.count == 10


@pytest.mark.parametrize(
    "options",
    [
        {"correction": PerStep()},
        {"baseline": EpisodeMean()},
        {"discount_steps": True},
        {"normalize_advantage": True},
        {"entropy_coeff": 0.1},
    ],
    ids=lambda options: next(iter(options)),
)
def test_other_losses_read_the_frames(options, build):
    Counting.count = 0
    trainer = build(
        Softmax(), collector=FusedCollector, loss=partial(Counting, **options), max_iterations=3
    )
    assert trainer.loss.array_backward() is None
    trainer.run()
    assert Counting.count == 0


@pytest.mark.parametrize("method", ["forward", "backward", "step"])
def test_a_changed_loss_is_not_passed_over(method, train):
    calls = []

    def changed(self, tensordict):
        calls.append(len(tensordict))
        return getattr(ReinforceLoss, method)(self, tensordict)

    trainer = train(
        Softmax(),
        collector=FusedCollector,
        loss=type("Changed", (ReinforceLoss,), {method: changed}),
    )
    assert len(calls) == trainer.trials.iteration
    assert sum(calls) == trainer.trials.frames.sum()


def test_renamed_entries_are_read_from_the_frames(build):
    """The names may change until the training begins."""
    one, two = (build(Softmax(), collector=FusedCollector) for _ in range(2))
    one.loss.set_keys(reward="episode_reward")
    one.run()
    two.run()
    assert one.loss.array_backward() is None
    assert not torch.equal(*(t.optimizer.parameters[0].detach() for t in (one, two)))


@pytest.mark.parametrize("method", ["backward", "step", "_episodes"])
@pytest.mark.parametrize("late", [False, True])
def test_a_method_of_the_object_is_not_passed_over(method, late, build):
    def loss(*args, **options):
        made = ReinforceLoss(*args, **options)
        return made if late else changed(made)

    def changed(made):
        own = getattr(made, method)

        def called(*args):
            calls.append(method)
            return own(*args)

        setattr(made, method, called)
        return made

    calls: list[str] = []
    trainer = build(Softmax(), collector=FusedCollector, loss=loss, max_iterations=4)
    if late:
        changed(trainer.loss)
    trainer.run()
    assert len(calls) >= 4


def test_a_step_of_a_strategy_that_is_set_later_gets_the_frames(build):
    class Own(EpsilonGreedy):
        pass

    seen = []

    def step(self, frames=None):
        seen.append(frames["next", "reward"].sum().item())
        EpsilonGreedy.step(self, frames)

    Own.step = step
    trainer = build(Own(), collector=FusedCollector, max_iterations=3)
    trainer.run()
    assert len(seen) == 3
    assert min(seen) > 0


@pytest.mark.parametrize("place", ["_collect", "collect"])
def test_frames_that_a_collector_changes_are_learned_from(place, build):
    def doubled(self, active):
        rollout = getattr(super(Double, self), place)(active)
        rollout.frames["next"].set("reward", 2 * rollout.frames["next", "reward"])
        return rollout

    class Double(FusedCollector):
        pass

    setattr(Double, place, doubled)
    found = []
    for collector, loss in (
        (Double, ReinforceLoss),
        (Double, Framewise),
        (FusedCollector, Framewise),
    ):
        trainer = build(Softmax(), collector=collector, loss=loss, max_iterations=6)
        trainer.run()
        found.append(trainer.optimizer.parameters[0].detach())
    assert torch.equal(found[0], found[1])
    assert not torch.equal(found[0], found[2])


def test_a_rollout_unpacks_like_a_tuple(build):
    rollout = build(Softmax(), collector=FusedCollector).collector.collect()
    frames, score, length = rollout
    assert len(rollout) == 3
    assert rollout[0] is frames is rollout.frames
    assert rollout[1] is score
    assert rollout[2] is length
    assert rollout.count == len(frames) == length.sum()


@pytest.mark.parametrize("hook", ["register_hook", "register_post_accumulate_grad_hook"])
def test_hooks_of_the_weights_are_called(hook, build):
    trainer = build(Softmax(), collector=FusedCollector, max_iterations=3)
    (weight,) = trainer.optimizer.parameters
    seen = []
    getattr(weight, hook)(seen.append)
    trainer.run()
    assert len(seen) == 3


def test_a_strategy_that_declares_to_need_no_data_gets_their_number(train):
    sizes = []

    class Curious(EpsilonGreedy):
        learns_from_data = False

        def step(self, frames=None):
            assert frames.is_empty()
            sizes.append(len(frames))
            super().step(frames)

    trainer = train(Curious(), collector=FusedCollector)
    assert len(sizes) == trainer.trials.iteration
    assert sum(sizes) == trainer.trials.frames.sum() == int(trainer.collector.strategy.frames)


def test_a_step_in_place_of_every_strategys_is_called(build, monkeypatch):
    trainer = build(Softmax(), collector=FusedCollector, max_iterations=3)
    steps = []
    monkeypatch.setattr(BaseStrategy, "step", lambda self, frames=None: steps.append(len(frames)))
    trainer.run()
    assert steps == [frames for frames in steps if frames > 0]
    assert sum(steps) == trainer.trials.frames.sum()


def test_every_trial_counts_its_own_frames(train):
    strategy = EpsilonGreedy(Linear(1.0, 0.0, frames=300))
    trainer = train(strategy, trials=4, max_iterations=6, collector=FusedCollector)
    frames = trainer.collector.strategy.frames.numpy()
    assert frames.tolist() == trainer.trials.frames.tolist()
    assert len(set(frames.tolist())) > 1


def test_numbers_of_the_loss_may_change_during_the_training(build):
    """As for a collector without arrays."""

    def change(trials):
        trainer.loss.gamma, trainer.loss.weight = 0.1, 0.5

    found = []
    for collector in (FusedCollector, TorchRLCollector):
        trainer = build(Softmax(), collector=collector, max_iterations=5)
        trainer.on_iteration = change
        trainer.run()
        found.append(trainer.optimizer.parameters[0].detach())
    unchanged = build(Softmax(), collector=FusedCollector, max_iterations=5)
    unchanged.run()
    assert torch.equal(*found)
    assert not torch.equal(found[0], unchanged.optimizer.parameters[0].detach())


def test_weights_of_another_number_of_trials_are_not_read_as_arrays(build):
    loss = build(Softmax(), trials=3, collector=FusedCollector).loss
    assert loss.array_backward() is not None
    loss.trials = 4
    assert loss.array_backward() is None
