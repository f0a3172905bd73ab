import math

import numpy as np
import pytest
import torch
from scipy import stats
from torch.distributions import Independent, Normal

from trl_explore.numerics.densities import categorical_log_prob, gaussian_entropy, gaussian_log_prob

SINGLE = [torch.float32, torch.float64]


def plain(logits, action):
    return logits.log_softmax(-1).gather(-1, action.unsqueeze(-1)).squeeze(-1)


def test_by_hand():
    logits = torch.tensor([[0.0, math.log(3.0)], [math.log(5.0), math.log(3.0)]])
    out = categorical_log_prob(logits, torch.tensor([1, 0]))
    torch.testing.assert_close(out, torch.tensor([math.log(0.75), math.log(0.625)]))


def test_gradient_by_hand():
    logits = torch.tensor([[0.0, math.log(3.0)]] * 2, requires_grad=True)
    categorical_log_prob(logits, torch.tensor([1, 0])).backward(torch.tensor([1.0, 2.0]))
    torch.testing.assert_close(logits.grad, torch.tensor([[-0.25, 0.25], [1.5, -1.5]]))


@pytest.mark.parametrize("n_actions", [1, 2, 7])
@pytest.mark.parametrize("dtype", SINGLE)
def test_agrees_with_torch(n_actions, dtype):
    torch.manual_seed(0)
    logits = 3 * torch.randn(50, n_actions, dtype=dtype)
    action, upstream = torch.randint(n_actions, (50,)), torch.randn(50, dtype=dtype)
    values, gradients = [], []
    for function in (categorical_log_prob, plain):
        leaf = logits.clone().requires_grad_()
        value = function(leaf, action)
        value.backward(upstream)
        values.append(value.detach())
        gradients.append(leaf.grad)
    assert values[0].dtype == dtype
    torch.testing.assert_close(*values)
    torch.testing.assert_close(*gradients)


def test_gradcheck():
    torch.manual_seed(1)
    logits = torch.randn(4, 3, dtype=torch.float64, requires_grad=True)
    action = torch.tensor([0, 2, 1, 1])
    assert torch.autograd.gradcheck(lambda x: categorical_log_prob(x, action), logits)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_other_dtypes(dtype):
    torch.manual_seed(2)
    logits, action = torch.randn(9, 4), torch.randint(4, (9,))
    out = categorical_log_prob(logits.to(dtype), action)
    assert out.dtype == dtype
    torch.testing.assert_close(out.float(), plain(logits, action), rtol=0.05, atol=0.05)


@pytest.mark.parametrize("dtype", SINGLE)
def test_large_logits_neither_overflow_nor_vanish(dtype):
    logits = torch.tensor([[1e4, 1e4], [-1e4, -1e4], [1e4, -1e4], [1e4, -1e4]], dtype=dtype)
    logits.requires_grad_()
    out = categorical_log_prob(logits, torch.tensor([0, 1, 0, 1]))
    expected = torch.tensor([math.log(0.5), math.log(0.5), 0.0, -2e4], dtype=dtype)
    torch.testing.assert_close(out, expected)
    out.sum().backward()
    expected = torch.tensor([[0.5, -0.5], [-0.5, 0.5], [0, 0], [-1, 1]], dtype=dtype)
    torch.testing.assert_close(logits.grad, expected)


@pytest.mark.parametrize("dtype", SINGLE)
def test_a_forbidden_action_counts_for_nothing(dtype):
    logits = torch.tensor([[0.0, -torch.inf, math.log(3.0)]] * 2, dtype=dtype, requires_grad=True)
    out = categorical_log_prob(logits, torch.tensor([2, 1]))
    assert out[0].item() == pytest.approx(math.log(0.75))
    assert out[1].item() == -math.inf
    out[0].backward()
    torch.testing.assert_close(logits.grad[0], torch.tensor([-0.25, 0, 0.25], dtype=dtype))


@pytest.mark.parametrize("dtype", SINGLE)
@pytest.mark.parametrize("column", [0, 1])
def test_nan_stays_nan(dtype, column):
    logits = torch.zeros(2, 2, dtype=dtype)
    logits[1, column] = torch.nan
    out = categorical_log_prob(logits, torch.tensor([0, 0]))
    assert out.isnan().tolist() == [False, True]


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("batch", [(), (3,), (2, 3), (0,), (2, 0)])
def test_batch_shapes(batch, dtype):
    torch.manual_seed(3)
    logits, action = torch.randn(*batch, 4, dtype=dtype), torch.randint(4, batch)
    out = categorical_log_prob(logits.requires_grad_(), action)
    assert out.shape == batch
    torch.testing.assert_close(out, plain(logits, action))
    out.sum().backward()
    assert logits.grad.shape == logits.shape


@pytest.mark.parametrize("dtype", [torch.int32, torch.uint8, torch.float32])
def test_actions_of_other_dtypes(dtype):
    logits = torch.tensor([[0.0, math.log(3.0)]])
    out = categorical_log_prob(logits, torch.tensor([1], dtype=dtype))
    assert out.item() == pytest.approx(math.log(0.75))


@pytest.mark.parametrize("action", [-1, 2, 1000])
def test_an_action_that_does_not_exist(action):
    with pytest.raises(IndexError, match=r"action.*\[0, 2\)"):
        categorical_log_prob(torch.zeros(3, 2), torch.tensor([0, action, 1]))


def test_layout_in_memory_does_not_matter():
    torch.manual_seed(4)
    logits = torch.randn(3, 8)
    action = torch.stack([torch.randint(3, (8,))] * 2, 1)
    upstream = torch.randn(8, 2)
    results = []
    for contiguous in (True, False):
        leaf = logits.T.contiguous() if contiguous else logits.T
        leaf = leaf.detach().requires_grad_()
        column, weight = action[:, 0], upstream[:, 0]
        out = categorical_log_prob(leaf, column.contiguous() if contiguous else column)
        out.backward(weight.contiguous() if contiguous else weight)
        results.append((out.detach(), leaf.grad))
    assert torch.equal(results[0][0], results[1][0])
    assert torch.equal(results[0][1], results[1][1])


def test_the_gradient_of_a_gradient_is_refused():
    # The backward pass is compiled; silence would be a wrong second derivative.
    logits = torch.zeros(1, 2, requires_grad=True)
    (gradient,) = torch.autograd.grad(
        (categorical_log_prob(logits, torch.tensor([0])) * logits.sum()).sum(),
        logits,
        create_graph=True,
    )
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("masked", [[0], [1], [2], [0, 1], [1, 2], [0, 2]])
def test_a_mask_in_any_place(masked, dtype):
    logits = torch.tensor([0.5, -1.0, 2.0], dtype=dtype)
    logits[masked] = -torch.inf
    logits.requires_grad_()
    for action in sorted({0, 1, 2} - set(masked)):
        ours = categorical_log_prob(logits.unsqueeze(0), torch.tensor([action]))
        plain = logits.log_softmax(-1)[action]
        torch.testing.assert_close(ours[0], plain)
        (gradient,) = torch.autograd.grad(ours.sum(), logits)
        (expected,) = torch.autograd.grad(plain, logits)
        torch.testing.assert_close(gradient, expected)


# The Gaussian


def numbers(*shape, dtype=torch.float64):
    generator = torch.Generator().manual_seed(2)
    loc, action = (3 * torch.randn(*shape, generator=generator, dtype=dtype) for _ in range(2))
    scale = torch.rand(*shape, generator=generator, dtype=dtype) * 5 + 1e-3
    return action, loc, scale


def test_gaussian_by_hand():
    # (3 - 1) / 2 = 1 and (0 - 0) / 0.5 = 0: -1/2 - log 2 - log 0.5 - log 2 pi.
    action, loc, scale = torch.tensor([[3.0, 0.0], [1.0, 0.0], [2.0, 0.5]])
    expected = -0.5 - math.log(2 * math.pi)
    assert gaussian_log_prob(action, loc, scale).item() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("shape", [(50, 1), (50, 4), (2, 3, 5), (6,), (0, 2)])
def test_density_and_entropy_are_scipys(shape):
    action, loc, scale = numbers(*shape)
    density = stats.norm.logpdf(action.numpy(), loc.numpy(), scale.numpy()).sum(-1)
    np.testing.assert_allclose(gaussian_log_prob(action, loc, scale), density, rtol=1e-12)
    entropy = stats.norm.entropy(loc.numpy(), scale.numpy()).sum(-1)
    np.testing.assert_allclose(gaussian_entropy(scale), entropy, rtol=1e-12)


def test_gradients_are_those_of_torchs_distributions():
    action, *parameters = (x.requires_grad_() for x in numbers(20, 3))
    ours = torch.autograd.grad(gaussian_log_prob(action, *parameters).sum(), [action, *parameters])
    normal = Independent(Normal(*parameters), 1)
    theirs = torch.autograd.grad(normal.log_prob(action).sum(), [action, *parameters])
    torch.testing.assert_close(ours, theirs)
    ours = torch.autograd.grad(gaussian_entropy(parameters[1]).sum(), parameters[1])
    theirs = torch.autograd.grad(normal.entropy().sum(), parameters[1])
    torch.testing.assert_close(ours, theirs)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_frame_is_the_same_wherever_it_stands(dtype):
    columns = numbers(40, 3, dtype=dtype)
    together = gaussian_log_prob(*columns)
    for k in range(40):
        assert torch.equal(gaussian_log_prob(*(x[k : k + 1] for x in columns))[0], together[k])


def test_gaussian_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"scale.*\[2\].*frames.* \[3, 2\]"):
        gaussian_log_prob(torch.zeros(3, 2), torch.zeros(3, 2), torch.ones(2))
