"""The bias of another strategy: weights by hand, iterations, trials, masks and refusals."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from trl_explore.collectors import FusedCollector
from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.corrections import AsIf, NoCorrection
from trl_explore.policies.actor import SoftmaxActor
from trl_explore.strategies import (
    VDBE,
    Argmax,
    DecayingEpsilonGreedy,
    EpsilonGreedy,
    EpsilonZGreedy,
    Gaussian,
    ParameterNoise,
    Softmax,
)

LOGITS = torch.tensor([[0.0, 2.0], [0.0, 2.0], [1.0, 1.0]])


def weights(correction, acting=None, logits=LOGITS, **more):
    """The factors of one-step episodes with reward 1, in which action 0 had probability 1/2."""
    actor = SoftmaxActor(TensorDictModule(lambda x: x, ["observation"], ["logits"]))
    loss = ReinforceLoss(actor, correction=correction, strategy=acting, functional=False)
    n = len(logits)
    data = {
        "observation": logits, "trial": torch.arange(n), "action": torch.tensor([0, 1, 0])[:n],
        "action_log_prob": torch.full((n,), 0.5).log(),
        "next": {"reward": torch.ones(n, 1), "done": torch.ones(n, 1, dtype=torch.bool)},
    }  # fmt: skip
    return loss.advantage(TensorDict(data | more, [n])).tolist()


def test_the_weights_by_hand():
    # ε = 0.3: 0.15 for the other action, 0.85 for the greedy one, 0.5 for each of two equals.
    assert weights(AsIf(EpsilonGreedy(0.3))) == pytest.approx([0.3, 1.7, 1.0])
    assert weights(AsIf(Argmax())) == [0.0, 2.0, 1.0]


def test_per_trial_parameters():
    found = weights(AsIf(EpsilonGreedy([0.0, 0.2, 1.0])))
    assert found == pytest.approx([0.0, 1.8, 1.0])
    cut = AsIf(EpsilonGreedy([0.9, 0.9, 0.0, 0.2, 1.0]))
    cut.take(slice(2, 5), 5)
    assert weights(cut) == pytest.approx(found)
    with pytest.raises(ValueError, match="epsilon has 2 values, but there are 5 trials"):
        AsIf(EpsilonGreedy([0.1, 0.2])).take(slice(0, 5), 5)


def test_a_forbidden_action_has_no_share_in_the_assumed_strategy():
    mask = torch.tensor([[True, False], [False, True], [True, True]])
    found = weights(AsIf(EpsilonGreedy(0.3)), action_mask=mask)
    assert found == pytest.approx([2.0, 2.0, 1.0])


def test_schedules_follow_the_strategy_that_acts():
    acting = Softmax()
    correction = AsIf(DecayingEpsilonGreedy(0.5))
    assert weights(correction, acting) == pytest.approx([1.0, 1.0, 1.0])  # ε = 1
    acting.step()
    assert weights(correction, acting) == pytest.approx([0.5, 1.5, 1.0])  # ε = 0.5
    acting.iteration = 3
    assert weights(correction, acting) == pytest.approx([0.125, 1.875, 1.0])


@pytest.mark.parametrize(
    ("strategy", "message"),
    [
        (VDBE(), "follow from logits and iteration alone"),
        (EpsilonZGreedy(), "follow from logits and iteration alone"),
        (ParameterNoise(), "follow from logits and iteration alone"),
        (Gaussian(), "over discrete actions, got Gaussian"),
    ],
)
def test_strategies_whose_probabilities_are_not_a_function_of_the_logits(strategy, message):
    with pytest.raises(ValueError, match=message):
        AsIf(strategy)


def test_strategies_that_cannot_act_with_it():
    correction = AsIf(EpsilonGreedy())
    with pytest.raises(ValueError, match="EpsilonZGreedy does not have"):
        weights(correction, EpsilonZGreedy())
    with pytest.raises(ValueError, match="needs discrete actions; Gaussian draws continuous ones"):
        weights(correction, Gaussian())


def test_as_if_itself_learns_what_no_correction_learns(build):
    """Up to the rounding of the weights: the same episodes, and nearly the same policy."""

    def trained(correction):
        strategy = EpsilonGreedy(0.3)
        loss = partial(ReinforceLoss, correction=correction, strategy=strategy)
        trainer = build(strategy, 4, loss=loss, collector=FusedCollector, max_iterations=10)
        trainer.run()
        return trainer.optimizer.parameters[0].detach().clone()

    plain = trained(NoCorrection())
    torch.testing.assert_close(trained(AsIf(EpsilonGreedy(0.3))), plain, atol=1e-4, rtol=1e-3)
    assert (trained(AsIf(Softmax())) - plain).abs().max() > 0.01
