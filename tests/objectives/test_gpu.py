"""The loss on a GPU: losses and gradients of the CPU, for every correction and baseline."""

from __future__ import annotations

from itertools import product

import pytest
import torch
from tensordict.nn import TensorDictSequential

from tests.objectives.frames import categorical, frames, network
from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.baselines import (
    Constant,
    EpisodeMean,
    LeaveOneOut,
    StepMean,
)
from trl_explore.objectives.corrections import (
    AsIf,
    Behaviour,
    NoCorrection,
    PerDecision,
    PerStep,
    Trajectory,
)
from trl_explore.strategies import EpsilonSoftmax

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")

BASELINES = [Constant, EpisodeMean, LeaveOneOut, StepMean]


def corrections(strategy):
    return [NoCorrection(), PerStep(), PerDecision(), Trajectory(), AsIf(strategy), Behaviour()]


def collected(strategy):
    """Frames of three trials and 60 steps, with log μ of the strategy's own draws."""
    given = frames(3, 60)
    torch.manual_seed(1)
    return TensorDictSequential(network(), strategy)(given)


def losses(number, baseline, device, **options):
    strategy = EpsilonSoftmax(0.4)
    given = collected(strategy).to(device)
    actor = categorical(network()).to(device)
    correction = corrections(strategy)[number]
    loss = ReinforceLoss(
        actor, correction=correction, strategy=strategy.to(device), baseline=baseline(), trials=3,
        functional=False, **options,
    ).to(device)  # fmt: skip
    out = loss(given.clone())
    loss.backward(given)
    loss.step(given)
    return out.to("cpu"), [p.grad.cpu() for p in actor.parameters()], loss.advantage(given).cpu()


@pytest.mark.parametrize(("number", "baseline"), list(product(range(6), BASELINES)))
def test_the_loss_and_its_gradient_are_those_of_the_cpu(number, baseline):
    there, there_gradients, there_advantage = losses(number, baseline, "cpu")
    here, here_gradients, here_advantage = losses(number, baseline, "cuda")
    assert torch.isfinite(there["loss_actor"])
    for name in there.sorted_keys:
        torch.testing.assert_close(here[name], there[name], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(here_gradients, there_gradients, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(here_advantage, there_advantage, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    "options",
    [
        {"discount_steps": True},
        {"normalize_advantage": True},
        {"entropy_coeff": 0.1},
    ],
    ids=lambda options: next(iter(options)),
)
def test_every_form_of_the_loss(options):
    there, there_gradients, _ = losses(1, Constant, "cpu", **options)
    here, here_gradients, _ = losses(1, Constant, "cuda", **options)
    torch.testing.assert_close(here["loss_actor"], there["loss_actor"], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(here_gradients, there_gradients, rtol=1e-4, atol=1e-4)
