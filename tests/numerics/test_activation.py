import numpy as np
import pytest
import torch

from trl_explore.numerics.activation import ACTIVATIONS, activate

NAMES = pytest.mark.parametrize("name", ACTIVATIONS)


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
def test_gradcheck(name):
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
def test_other_dtypes_take_the_plain_path(name):
    x = torch.tensor([-0.5, 0.25], dtype=torch.bfloat16)
    assert torch.equal(activate(x, name), getattr(torch, name)(x))


def test_an_unknown_activation():
    with pytest.raises(ValueError, match=r"^activation.*tanh.*relu.*'gelu'"):
        activate(torch.zeros(1), "gelu")
