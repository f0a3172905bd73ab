"""Where μ is π by construction, every correction is the same run, bit for bit."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import torch

from trl_explore.collectors import FusedCollector
from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.corrections import (
    AsIf,
    Behaviour,
    NoCorrection,
    PerDecision,
    PerStep,
    Trajectory,
)
from trl_explore.strategies import (
    EpsilonGreedy,
    EpsilonSoftmax,
    Gaussian,
    ParameterNoise,
    Softmax,
)
from trl_explore.strategies.schedules import Linear

CORRECTIONS = {
    "per_step": PerStep(),
    "per_decision": PerDecision(),
    "trajectory": Trajectory(),
    "clipped": PerStep(clip=2.0),
    "behaviour": Behaviour(),
    "as_if": AsIf(Softmax()),
}


def weights(build, strategy, correction, id="CartPole-v1", **options):
    loss = partial(ReinforceLoss, correction=correction, strategy=strategy, **options)
    trainer = build(strategy, 4, id=id, loss=loss, collector=FusedCollector, max_iterations=12)
    trainer.run()
    (weight,) = trainer.optimizer.parameters
    return weight.detach().clone()


@pytest.mark.parametrize("id", ["CartPole-v1", "Acrobot-v1"])
@pytest.mark.parametrize("name", CORRECTIONS)
def test_a_correction_changes_no_bit_on_policy(build, name, id):
    correction = CORRECTIONS[name]
    plain = weights(build, Softmax(), NoCorrection(), id)
    assert torch.equal(weights(build, Softmax(), correction, id), plain)
    assert not torch.equal(weights(build, Softmax(0.5), correction, id), plain)


@pytest.mark.parametrize("name", ["per_step", "trajectory"])
def test_a_trial_whose_temperature_is_1_is_on_policy_among_others(build, name):
    correction = CORRECTIONS[name]
    both = Softmax([1.0, 0.5, 1.0, 2.0])
    found, plain = weights(build, both, correction), weights(build, Softmax(), NoCorrection())
    assert torch.equal(found[::2], plain[::2])
    assert not torch.equal(found[1::2], plain[1::2])


def test_which_strategies_are_the_target_policy():
    assert Softmax().on_policy() is True
    assert Softmax().is_target()
    assert EpsilonSoftmax(0.0).is_target()
    assert Gaussian().is_target()
    assert not Gaussian(0.5).on_policy()
    assert not EpsilonSoftmax(0.1).on_policy()
    assert not EpsilonGreedy(0.0).on_policy()
    assert not ParameterNoise(0.1).on_policy()
    assert np.array_equal(Softmax([1.0, 2.0]).on_policy(), [True, False])
    cooling = Softmax(Linear(2.0, 1.0, 1))
    assert not cooling.on_policy()
    cooling.step()
    assert cooling.on_policy() is True
    assert not cooling.is_target()  # it was not, one iteration before


def test_what_changes_the_strategy_makes_it_another_policy():
    class Other(Softmax):
        def probs(self, logits, trial=None):
            return torch.softmax(-logits, -1)

    patched = Softmax()
    patched.preferences = lambda tensordict, logits: 2 * logits
    assert not Other().on_policy()
    assert not patched.on_policy()


def test_discounted_steps_do_not_depend_on_the_other_trials(train):
    loss = partial(ReinforceLoss, discount_steps=True)
    options = {"loss": loss, "collector": FusedCollector, "max_iterations": 60}
    alone = train(Softmax(), 1, first_trial=7, score_threshold=1e9, **options)
    among = train(Softmax(), 40, score_threshold=1e9, **options)
    one, other = (t.optimizer.parameters[0].detach() for t in (alone, among))
    assert torch.equal(one[0], other[7])
