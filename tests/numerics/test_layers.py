import numpy as np
import pytest
import torch

from trl_explore.numerics import dispatch
from trl_explore.numerics.layers import ACTIVATIONS, activate, lane_linear, plain_lane_linear

BOTH = pytest.mark.parametrize("linear", [lane_linear, plain_lane_linear])
"""The compiled path and the plain one."""
NAMES = pytest.mark.parametrize("name", ACTIVATIONS)


def plain(x, weight, trial):
    """The formula, frame by frame."""
    frames = [weight[k] @ row for row, k in zip(x, trial.tolist(), strict=True)]
    return torch.stack(frames)


def problem(frames=40, trials=5, n_out=3, n_in=4, dtype=torch.float64):
    torch.manual_seed(0)
    x = torch.randn(frames, n_in, dtype=dtype)
    weight = torch.randn(trials, n_out, n_in, dtype=dtype)
    return x, weight, torch.randint(trials, (frames,))


def test_by_hand():
    x = torch.tensor([[1.0, 2.0], [3.0, 4.0], [1.0, 0.0]])
    weight = torch.tensor([[[1.0, 1.0], [0.0, 2.0]], [[10.0, 1.0], [-1.0, 0.5]]])
    out = lane_linear(x, weight, torch.tensor([1, 0, 1]))
    assert out.tolist() == [[12.0, 0.0], [7.0, 8.0], [10.0, -1.0]]


def test_gradient_by_hand():
    x = torch.tensor([[1.0, 2.0], [3.0, 4.0], [1.0, 0.0]])
    weight = torch.zeros(3, 2, 2, requires_grad=True)
    out = lane_linear(x, weight, torch.tensor([1, 0, 1]))
    out.backward(torch.tensor([[1.0, 0.0], [2.0, -1.0], [10.0, 1.0]]))
    assert weight.grad.tolist() == [
        [[6.0, 8.0], [-3.0, -4.0]],
        [[11.0, 2.0], [1.0, 0.0]],
        [[0.0, 0.0], [0.0, 0.0]],
    ]


@BOTH
@pytest.mark.parametrize("n_out", [1, 3, 7, 8, 20])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_both_paths_are_the_formula(linear, dtype, n_out):
    for n_in in (1, 4, 5, 6, 11):
        x, weight, trial = problem(n_out=n_out, n_in=n_in, dtype=dtype)
        bias = torch.randn(5, n_out, dtype=dtype)
        for frames in (trial, trial.sort().values):  # alone, and many of a lane in a row
            expected = plain(x.double(), weight.double(), frames)
            out = linear(x, weight, frames)
            assert out.dtype == dtype
            tolerance = 1e-5 if dtype == torch.float32 else 1e-13
            torch.testing.assert_close(out.double(), expected, rtol=tolerance, atol=tolerance)
            out = linear(x, weight, frames, bias)
            expected += bias.double()[frames]
            torch.testing.assert_close(out.double(), expected, rtol=tolerance, atol=tolerance)


@BOTH
@pytest.mark.parametrize("n_out", [3, 9])
def test_gradcheck(linear, n_out):
    x, weight, trial = problem(frames=6, trials=3, n_out=n_out)
    bias = torch.randn(3, n_out, dtype=torch.float64)
    inputs = (x.requires_grad_(), weight.requires_grad_(), bias.requires_grad_())
    for frames in (trial, trial.sort().values):
        assert torch.autograd.gradcheck(
            lambda x, w, b, frames=frames: linear(x, w, frames, b), inputs
        )
        assert torch.autograd.gradcheck(
            lambda x, w, frames=frames: linear(x, w, frames), inputs[:2]
        )


def test_gradients_that_nobody_asks_for():
    """Any of the three alone, as where the first layer's input is data."""
    x, weight, trial = problem(frames=6, trials=3)
    bias = torch.randn(3, 3, dtype=torch.float64)
    for asked in range(3):
        inputs = [x.clone(), weight.clone(), bias.clone()]
        inputs[asked].requires_grad_()
        lane_linear(inputs[0], inputs[1], trial, inputs[2]).sum().backward()
        expected = [value.clone() for value in inputs]
        expected[asked] = inputs[asked].detach().clone().requires_grad_()
        plain_lane_linear(expected[0], expected[1], trial, expected[2]).sum().backward()
        torch.testing.assert_close(inputs[asked].grad, expected[asked].grad)
        assert sum(value.grad is not None for value in inputs) == 1


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_of_both_paths_agree(dtype):
    x, weight, trial = problem(frames=300, n_out=9, dtype=dtype)
    bias = torch.randn(5, 9, dtype=dtype)
    upstream = torch.randn(300, 9, dtype=dtype)
    gradients = []
    for linear in (lane_linear, plain_lane_linear):
        inputs = [value.clone().requires_grad_() for value in (x, weight, bias)]
        linear(inputs[0], inputs[1], trial, inputs[2]).backward(upstream)
        gradients.append([value.grad for value in inputs])
    assert gradients[0][0].dtype == dtype
    tolerance = 1e-4 if dtype == torch.float32 else 1e-12
    for ours, theirs in zip(*gradients, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=tolerance, atol=tolerance)


def test_a_gradient_in_float32_is_summed_in_float64():
    torch.manual_seed(3)
    x, upstream = torch.rand(20_000, 2), torch.rand(20_000, 1)
    weight = torch.zeros(1, 1, 2, requires_grad=True)
    lane_linear(x, weight, torch.zeros(20_000, dtype=torch.int64)).backward(upstream)
    exact = (x.double() * upstream.double()).sum(0)
    np.testing.assert_array_max_ulp(weight.grad[0, 0].numpy(), exact.float().numpy(), 1)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_other_dtypes_take_the_plain_path(dtype):
    x, weight, trial = (problem()[0].to(dtype), problem()[1].to(dtype), problem()[2])
    out = lane_linear(x, weight, trial)
    assert out.dtype == dtype
    expected = plain(x.double(), weight.double(), trial)
    torch.testing.assert_close(out.double(), expected, rtol=0.05, atol=0.1)


@pytest.mark.parametrize("batch", [(), (1,), (6,), (2, 3), (2, 1, 3), (0,), (0, 3)])
@BOTH
def test_batch_shapes(batch, linear):
    x, weight, trial = torch.randn(*batch, 4), torch.randn(5, 3, 4), torch.randint(5, batch)
    out = linear(x.requires_grad_(), weight.requires_grad_(), trial)
    assert out.shape == (*batch, 3)
    expected = torch.einsum("foi,fi->fo", weight[trial.reshape(-1)], x.reshape(-1, 4))
    torch.testing.assert_close(out.reshape(-1, 3), expected)
    out.sum().backward()
    assert weight.grad.shape == weight.shape


def test_layout_in_memory_does_not_matter():
    x, weight, trial = problem()
    upstream = torch.randn(3, 40, dtype=torch.float64)
    results = []
    for contiguous in (True, False):
        values = (x.T.contiguous().T, weight.mT.contiguous().mT, torch.stack([trial] * 2, 1)[:, 0])
        xs, w, k = (v.contiguous() if contiguous else v for v in values)
        w = w.detach().requires_grad_()
        out = lane_linear(xs, w, k)
        out.backward(upstream.T.contiguous() if contiguous else upstream.T)
        results.append((out.detach(), w.grad))
    assert torch.equal(results[0][0], results[1][0])
    assert torch.equal(results[0][1], results[1][1])


@BOTH
@pytest.mark.parametrize("n_out", [3, 16])
def test_a_lane_does_not_depend_on_its_neighbours(linear, n_out):
    x, weight, trial = problem(frames=400, trials=30, n_out=n_out, dtype=torch.float32)
    upstream, bias = torch.randn(400, n_out), torch.randn(30, n_out)

    def run(rows, weight, bias, trial):
        inputs = [value.clone().requires_grad_() for value in (x[rows], weight, bias)]
        out = linear(inputs[0], inputs[1], trial, inputs[2])
        out.backward(upstream[rows])
        return out.detach(), [value.grad for value in inputs]

    together, (to_x, *gradients) = run(slice(None), weight, bias, trial)
    for lane in range(30):
        rows = trial == lane
        frames = torch.zeros(int(rows.sum()), dtype=torch.int64)
        alone, (own_x, *own) = run(rows, weight[[lane]], bias[[lane]], frames)
        assert torch.equal(alone, together[rows])
        assert torch.equal(own_x, to_x[rows])
        for gradient, one in zip(gradients, own, strict=True):
            assert torch.equal(one[0], gradient[lane])


# Compiled code that does not look reads, and on the way back writes, beside the arrays. Here they
# are parts of larger ones, so that such code fails these tests and not the process.


@BOTH
@pytest.mark.parametrize("trial", [-1, 2])
def test_a_trial_that_does_not_exist(trial, linear):
    x, weight = torch.ones(3, 4), torch.ones(9, 3, 4)[3:5]
    with pytest.raises(IndexError):
        linear(x, weight, torch.tensor([0, trial, 1]))


@BOTH
@pytest.mark.parametrize(("features", "trials"), [(3, 3), (5, 3), (4, 2)])
def test_shapes_that_do_not_fit(features, trials, linear):
    x, weight = torch.ones(9, features)[:3], torch.ones(2, 3, 4)
    trial = torch.zeros(9, dtype=torch.int64)[:trials]
    with pytest.raises((ValueError, RuntimeError, IndexError)):
        linear(x, weight, trial)


def test_a_bias_that_does_not_fit():
    x, weight, trial = problem()
    for shape in ((5, 2), (4, 3), (5,)):
        with pytest.raises(ValueError, match=r"bias.*\[.*\].*weights.*\[5, 3, 4"):
            lane_linear(x, weight, trial, torch.zeros(shape, dtype=torch.float64))


# Activations


def points(n=20_000, dtype=torch.float32) -> torch.Tensor:
    """Numbers of all sizes, both signs."""
    draws = torch.Generator().manual_seed(0)
    size = 10 ** (8 * torch.rand(n, generator=draws, dtype=torch.float64) - 6.5)
    return (size * (2 * torch.randint(2, (n,), generator=draws) - 1)).to(dtype)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_tanh_is_that_of_numpy(dtype):
    x = points(dtype=dtype)
    y = activate(x, "tanh")
    assert y.dtype == dtype
    exact = np.tanh(x.double().numpy())
    units = np.abs(y.double().numpy() - exact) / np.spacing(np.abs(exact).astype(y.numpy().dtype))
    assert units.max() < 6
    assert y.abs().max() <= 1


def test_tanh_at_its_ends():
    x = torch.tensor([0.0, torch.inf, -torch.inf, 1e30, torch.nan])
    y = activate(x, "tanh")
    assert y[:4].tolist() == [0, 1, -1, 1]
    assert y[4].isnan()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_relu_is_that_of_torch(dtype):
    x = points(dtype=dtype)
    assert torch.equal(activate(x, "relu"), torch.relu(x))
    assert activate(torch.tensor([torch.nan]), "relu").isnan()


@NAMES
def test_activation_gradcheck(name):
    x = points(40, torch.float64).clamp(-3, 3)
    x = torch.where(x.abs() < 1e-3, 0.5, x).requires_grad_()  # away from the corner of relu
    assert torch.autograd.gradcheck(lambda x: activate(x, name), x)


@NAMES
def test_gradients_by_torch(name):
    ours, theirs = (points(300).clamp(-2, 2).requires_grad_() for _ in range(2))
    upstream = torch.randn(300, generator=torch.Generator().manual_seed(1))
    activate(ours, name).backward(upstream)
    getattr(torch, name)(theirs).backward(upstream)
    torch.testing.assert_close(ours.grad, theirs.grad, rtol=1e-5, atol=1e-6)


@NAMES
def test_an_element_does_not_depend_on_its_place(name):
    x, upstream = points(200).clamp(-5, 5), torch.linspace(-1, 1, 200)

    def run(rows):
        own = x[rows].clone().requires_grad_()
        y = activate(own, name)
        y.backward(upstream[rows])
        return y.detach(), own.grad

    whole = run(slice(None))
    for first in range(0, 60, 3):
        for size in (1, 2, 3, 5, 8, 13, 21, 34):
            rows = slice(first, first + size)
            for part, all_of_them in zip(run(rows), whole, strict=True):
                assert torch.equal(part, all_of_them[rows]), (first, size)


@NAMES
def test_shapes_and_layouts(name):
    for shape in ((), (0,), (3, 4), (2, 0, 3)):
        assert activate(torch.ones(shape), name).shape == shape
    x = points(12).reshape(3, 4)
    assert torch.equal(activate(x.T, name), activate(x.T.contiguous(), name))


@NAMES
def test_activations_without_compiled_code_are_those_of_torch(name, monkeypatch):
    x = torch.tensor([-0.5, 0.25], dtype=torch.bfloat16)
    assert torch.equal(activate(x, name), getattr(torch, name)(x))
    monkeypatch.setattr(dispatch, "has_numba", lambda: False)
    assert torch.equal(activate(x.float(), name), getattr(torch, name)(x.float()))


def test_an_unknown_activation():
    with pytest.raises(ValueError, match=r"^activation must be tanh or relu, got 'gelu'$"):
        activate(torch.zeros(1), "gelu")
