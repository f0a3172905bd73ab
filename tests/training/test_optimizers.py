from __future__ import annotations

from functools import partial

import pytest
import torch
from torch import nn
from torch.optim import SGD, Adam, RMSprop

from trl_explore.training.optimizers import (
    COUPLING,
    ELEMENTWISE,
    LaneAdam,
    LaneOptimizer,
    torch_optimizer,
)

TORCH_ADAM = partial(torch_optimizer, name="Adam")
LANE_ADAMS = [LaneAdam, TORCH_ADAM]
BY_NAME = [
    *(partial(torch_optimizer, name=name) for name in ELEMENTWISE),
    partial(torch_optimizer, name="SGD", options={"momentum": 0.9, "nesterov": True}),
    partial(torch_optimizer, name="RMSprop", options={"momentum": 0.9, "centered": True}),
    partial(torch_optimizer, name="AdamW", options={"amsgrad": True, "weight_decay": 0.1}),
]


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
        *(partial(make, lr=0.1) for make in BY_NAME),
    ],
)
def test_a_stopped_trial_stays_as_it_was(factory):
    trials, steps = 4, gradients(4)
    parameter = nn.Parameter(weights(trials))
    optimizer = factory([parameter])
    move(optimizer, parameter, steps[0])
    move(optimizer, parameter, steps[1])
    before, moments = parameter.detach().clone(), state(optimizer, parameter)
    plain = isinstance(factory, partial) and factory.keywords == {"name": "SGD", "lr": 0.1}
    assert moments or plain, "the optimiser has state to guard"
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
        reference = Adam([alone], lr=0.05, foreach=False, fused=False)
        for gradient in steps if active[k] else steps[:2]:
            move(reference, alone, gradient[k])
        if factory is TORCH_ADAM:
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
@pytest.mark.parametrize("factory", [*LANE_ADAMS, *BY_NAME])
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
    for first in range(0, largest, 3):
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
@pytest.mark.parametrize("factory", [*LANE_ADAMS, BY_NAME[0]])
def test_wrong_learning_rates(factory, lr):
    with pytest.raises(ValueError, match=r"^lr.*> 0"):
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


@pytest.mark.parametrize("factory", [*LANE_ADAMS, *BY_NAME])
def test_a_state_dict_goes_on_where_it_was_taken(factory):
    steps = gradients(3)
    parameter = nn.Parameter(weights(3))
    optimizer = factory([parameter], lr=0.05)
    for gradient in steps[:2]:
        move(optimizer, parameter, gradient)
    state = optimizer.state_dict()
    other = nn.Parameter(parameter.detach().clone())
    for gradient in steps[2:]:
        move(optimizer, parameter, gradient)
    again = factory([other], lr=0.05)
    again.load_state_dict(state)
    for gradient in steps[2:]:
        move(again, other, gradient)
    assert torch.equal(parameter, other)
    assert only_plain(state)


def only_plain(value) -> bool:
    """Whether a state holds nothing but numbers and tensors in nested dicts."""
    if isinstance(value, dict):
        return all(isinstance(key, str) and only_plain(entry) for key, entry in value.items())
    return isinstance(value, int | float | str | torch.Tensor)


# Optimisers of torch by name


@pytest.mark.parametrize("name", ELEMENTWISE)
def test_a_trial_by_name_moves_as_under_torch_alone(name):
    """Three trials, one of which stops, against three optimisers with one trial each."""
    steps, start = gradients(3, steps=6), weights(3)
    parameter = nn.Parameter(start.clone())
    optimizer = torch_optimizer([parameter], name=name, lr=0.02)
    active = torch.tensor([True, False, True])
    for i, gradient in enumerate(steps):
        move(optimizer, parameter, gradient, None if i < 3 else active)
    for k in range(3):
        alone = nn.Parameter(start[k].clone())
        reference = getattr(torch.optim, name)([alone], lr=0.02, foreach=False)
        for gradient in steps if active[k] else steps[:3]:
            move(reference, alone, gradient[k])
        assert torch.equal(parameter[k], alone), k


def test_every_optimiser_of_torch_is_supported_or_refused_with_a_reason():
    names = {
        name
        for name, kind in vars(torch.optim).items()
        if isinstance(kind, type) and issubclass(kind, torch.optim.Optimizer)
    }
    assert names - {"Optimizer"} == {*ELEMENTWISE, *COUPLING}


@pytest.mark.parametrize("name", COUPLING)
def test_what_couples_trials_is_refused(name):
    with pytest.raises(ValueError, match=f"^{name}.*trials.*: "):
        torch_optimizer([nn.Parameter(torch.zeros(2, 1))], name=name)


def test_wrong_names_and_options():
    parameters = [nn.Parameter(torch.zeros(2, 1))]
    with pytest.raises(ValueError, match=r"^name.*ASGD, .*, SGD.*'sgd'"):
        torch_optimizer(parameters, name="sgd")
    message = "^SGD.*momentum, dampening, .*'moment'"
    for option in ("moment", "foreach", "lr", "differentiable"):
        with pytest.raises(ValueError, match=message.replace("moment'", f"{option}'")):
            torch_optimizer(parameters, name="SGD", options={option: 1})
    with pytest.raises(ValueError, match="Invalid momentum value"):
        torch_optimizer(parameters, name="SGD", options={"momentum": -1})


# Groups of parameters


@pytest.mark.parametrize("factory", [*LANE_ADAMS, partial(torch_optimizer, name="RMSprop")])
def test_groups_have_learning_rates_of_their_own(factory):
    steps = gradients(3)

    def run(make):
        policy, critic = nn.Parameter(weights(3)), nn.Parameter(weights(3, (5,)))
        optimizers = make(policy, critic)
        for gradient in steps:
            policy.grad, critic.grad = gradient.clone(), gradient.reshape(3, -1)[:, :5].clone()
            for optimizer in optimizers:
                optimizer.step(torch.tensor([True, True, False]))
        assert [p for o in optimizers for p in o.parameters] == [policy, critic]
        return policy.detach(), critic.detach()

    together = run(
        lambda policy, critic: [
            factory([{"params": [policy]}, {"params": critic, "lr": 0.7}], lr=0.05)
        ]
    )
    apart = run(lambda policy, critic: [factory([policy], lr=0.05), factory([critic], lr=0.7)])
    assert torch.equal(together[0], apart[0])
    assert torch.equal(together[1], apart[1])


@pytest.mark.parametrize("factory", [*LANE_ADAMS, BY_NAME[0]])
def test_wrong_groups(factory):
    group = {"params": [nn.Parameter(torch.zeros(2, 1))], "lr": -1.0}
    with pytest.raises(ValueError, match=r"^lr.*> 0.*-1\.0"):
        factory([group])


def test_a_group_of_the_compiled_adam_has_no_other_options():
    with pytest.raises(ValueError, match=r"'params'.*'lr'.*'eps'"):
        LaneAdam([{"params": [nn.Parameter(torch.zeros(2, 1))], "eps": 1e-3}])


def test_adam_needs_an_entry_for_every_trial():
    """One that is too short would be read beside, or move rows that it does not mean."""
    weight = torch.nn.Parameter(torch.zeros(4, 2))
    adam = LaneAdam([weight], lr=0.1)
    weight.grad = torch.ones(4, 2)
    for n in (1, 2, 5):
        with pytest.raises(ValueError, match=rf"^active.*\[{n}\].*4 trials"):
            adam.step(torch.ones(n, dtype=torch.bool))
    assert adam.steps == 0
    assert not weight.any()


def test_adam_takes_a_gradient_of_any_layout():
    one, other = (torch.nn.Parameter(torch.zeros(4, 2)) for _ in range(2))
    one.grad = torch.arange(8.0).reshape(2, 4).T
    other.grad = one.grad.contiguous()
    LaneAdam([one]).step()
    LaneAdam([other]).step()
    assert torch.equal(one, other)


def test_adam_follows_parameters_whose_memory_has_moved():
    weight = nn.Parameter(torch.zeros(2, 1))
    adam = LaneAdam([weight], lr=0.5)
    for _ in range(2):
        weight.data = torch.ones(2, 1)
        weight.grad = torch.ones(2, 1)
        adam.step()
        assert weight.flatten().tolist() == pytest.approx([0.5, 0.5])


def test_a_parameter_that_is_replaced_is_trained():
    first, second = nn.Parameter(torch.zeros(2, 1)), nn.Parameter(torch.full((2, 1), 5.0))
    adam = LaneAdam([first], lr=0.1)
    adam.parameters[0] = second
    move(adam, second, torch.ones(2, 1))
    assert second.flatten().tolist() == pytest.approx([4.9, 4.9])
    assert first.flatten().tolist() == [0.0, 0.0]


def test_moments_have_their_names():
    """After one step, m = (1 − β₁) g and v = (1 − β₂) g²."""
    weight = nn.Parameter(torch.zeros(1, 1))
    adam = LaneAdam([weight])
    move(adam, weight, torch.full((1, 1), 3.0))
    state = adam.state_dict()
    assert state["exp_avg"]["0"].item() == pytest.approx(0.3)
    assert state["exp_avg_sq"]["0"].item() == pytest.approx(0.009)
