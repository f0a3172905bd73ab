from __future__ import annotations

from functools import partial

import pytest
import torch
from torch import nn
from torch.optim import SGD, Adam, RMSprop

from trl_explore.optim import LaneAdam, LaneOptimizer, adam, torch_adam

LANE_ADAMS = [LaneAdam, torch_adam]


def lanes(factory):
    """The constructor of an optimiser over lanes from that of a torch optimiser."""
    return partial(LaneOptimizer, factory)


def gradients(trials: int, shape=(2, 4), steps: int = 5) -> list[torch.Tensor]:
    """Gradients of very different sizes [steps][trials, *shape]."""
    draws = torch.Generator().manual_seed(5)
    scale = 10.0 ** torch.randint(-4, 4, (trials, *[1] * len(shape)), generator=draws)
    return [torch.randn(trials, *shape, generator=draws) * scale for _ in range(steps)]


def weights(trials: int, shape=(2, 4)) -> torch.Tensor:
    return torch.randn(trials, *shape, generator=torch.Generator().manual_seed(6))


def move(optimizer, parameter: nn.Parameter, gradient: torch.Tensor, *args) -> None:
    parameter.grad = gradient.clone()
    optimizer.step(*args)


def state(optimizer, parameter: nn.Parameter) -> dict[str, torch.Tensor]:
    if isinstance(optimizer, LaneAdam):
        return {"m": optimizer.exp_avg[0].clone(), "v": optimizer.exp_avg_sq[0].clone()}
    entries = optimizer.optimizer.state[parameter].items()
    return {name: value.clone() for name, value in entries if value.shape == parameter.shape}


@pytest.mark.parametrize(
    "factory",
    [
        *LANE_ADAMS,
        lanes(partial(SGD, lr=0.1, momentum=0.9)),
        lanes(partial(RMSprop, lr=0.1)),
    ],
)
def test_a_stopped_trial_stays_as_it_was(factory):
    trials, steps = 4, gradients(4)
    parameter = nn.Parameter(weights(trials))
    optimizer = factory([parameter])
    move(optimizer, parameter, steps[0])
    move(optimizer, parameter, steps[1])
    before, moments = parameter.detach().clone(), state(optimizer, parameter)
    assert moments, "the optimiser has state to guard"
    active = torch.tensor([True, False, True, False])
    for gradient in steps[2:]:
        move(optimizer, parameter, gradient * active[:, None, None], active)
    after, moments_after = parameter.detach(), state(optimizer, parameter)
    assert torch.equal(after[~active], before[~active])
    assert (after[active] != before[active]).all()
    for name, moment in moments.items():
        assert torch.equal(moments_after[name][~active], moment[~active]), name
        assert (moments_after[name][active] != moment[active]).any(), name


@pytest.mark.parametrize("factory", LANE_ADAMS)
def test_a_stopped_trial_stays_even_where_it_is_not_finite(factory):
    parameter = nn.Parameter(weights(3))
    optimizer = factory([parameter], lr=0.05)
    first, second = gradients(3, steps=2)
    first[1] = torch.nan
    move(optimizer, parameter, first)
    move(optimizer, parameter, second, torch.tensor([True, False, True]))
    assert parameter[1].isnan().all()

    lone = nn.Parameter(weights(3)[[0, 2]])
    reference = factory([lone], lr=0.05)
    move(reference, lone, first[[0, 2]])
    move(reference, lone, second[[0, 2]])
    assert torch.equal(parameter[[0, 2]], lone)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("factory", LANE_ADAMS)
def test_active_trials_move_as_under_torch_adam(factory, dtype):
    trials, start = 5, weights(5).to(dtype)
    steps = [gradient.to(dtype) for gradient in gradients(5, steps=40)]
    parameter = nn.Parameter(start.clone())
    optimizer = factory([parameter], lr=0.05)
    active = torch.tensor([True, True, False, True, False])
    for i, gradient in enumerate(steps):
        move(optimizer, parameter, gradient, *([] if i < 2 else [active]))
    for k in range(trials):
        alone = nn.Parameter(start[k].clone())
        torch_adam = Adam([alone], lr=0.05, foreach=False, fused=False)
        for gradient in steps if active[k] else steps[:2]:
            move(torch_adam, alone, gradient[k])
        if factory is torch_adam:
            assert torch.equal(parameter[k], alone), k
        else:  # the same formula; a compiler may fuse a product and a sum
            torch.testing.assert_close(parameter[k], alone)


@pytest.mark.parametrize("factory", LANE_ADAMS)
def test_the_first_step_of_adam_is_lr(factory):
    parameter = nn.Parameter(torch.zeros(1, 1, 2))
    optimizer = factory([parameter])
    move(optimizer, parameter, torch.tensor([[[3.0, -0.2]]]))
    torch.testing.assert_close(parameter.detach(), torch.tensor([[[-0.05, 0.05]]]))


@pytest.mark.parametrize("shape", [(2, 4), (3, 5), (1, 1), (7,)])
@pytest.mark.parametrize("factory", LANE_ADAMS)
def test_a_trial_moves_alike_wherever_it_stands(factory, shape):
    largest = 37
    steps = gradients(largest, shape)

    def run(rows: slice) -> torch.Tensor:
        parameter = nn.Parameter(weights(largest, shape)[rows].clone())
        optimizer = factory([parameter], lr=0.05)
        for gradient in steps:
            move(optimizer, parameter, gradient[rows])
        return parameter.detach()

    whole = run(slice(None))
    for first in range(largest):
        for size in (1, 2, 3, 5, 8, 13, 21):
            rows = slice(first, first + size)
            assert torch.equal(run(rows), whole[rows]), (first, size)


@pytest.mark.parametrize("factory", LANE_ADAMS)
def test_several_parameters_and_forgotten_gradients(factory):
    parameters = [nn.Parameter(weights(2)), nn.Parameter(weights(2, (3,)))]
    optimizer = factory(iter(parameters), lr=0.05)
    assert optimizer.parameters == parameters
    for parameter in parameters:
        parameter.grad = torch.ones_like(parameter)
    optimizer.step(torch.tensor([True, False]))
    for parameter, start in zip(parameters, (weights(2), weights(2, (3,))), strict=True):
        assert (parameter[0] != start[0]).all()
        assert torch.equal(parameter[1], start[1])
    optimizer.zero_grad()
    assert all(parameter.grad is None for parameter in parameters)


@pytest.mark.parametrize("lr", [0, -0.1, float("nan"), float("inf"), "fast", True])
@pytest.mark.parametrize("factory", [adam, *LANE_ADAMS])
def test_wrong_learning_rates(factory, lr):
    with pytest.raises(ValueError, match=r"^lr must be a number > 0, got"):
        factory([nn.Parameter(torch.zeros(1))], lr=lr)


def test_a_gradient_in_any_memory_layout():
    """Transposed weights and gradients move like contiguous ones."""
    gradient = gradients(3)[0]
    plain = nn.Parameter(weights(3))
    move(LaneAdam([plain]), plain, gradient)
    other = nn.Parameter(weights(3))
    other.grad = gradient.transpose(1, 2).contiguous().transpose(1, 2)
    LaneAdam([other]).step()
    assert torch.equal(plain, other)


def test_a_state_dict_goes_on_where_it_was_taken():
    steps = gradients(3)
    parameter = nn.Parameter(weights(3))
    optimizer = LaneAdam([parameter])
    for gradient in steps[:2]:
        move(optimizer, parameter, gradient)
    state = optimizer.state_dict()
    other = nn.Parameter(parameter.detach().clone())
    for gradient in steps[2:]:
        move(optimizer, parameter, gradient)
    again = LaneAdam([other])
    again.load_state_dict(state)
    for gradient in steps[2:]:
        move(again, other, gradient)
    assert torch.equal(parameter, other)
