import math

import numpy as np
import pytest
import torch
from scipy import stats
from torch.distributions import Independent, Normal

from trl_explore.numerics.gaussian import gaussian_entropy, gaussian_log_prob


def numbers(*shape, dtype=torch.float64):
    generator = torch.Generator().manual_seed(2)
    loc, action = (3 * torch.randn(*shape, generator=generator, dtype=dtype) for _ in range(2))
    scale = torch.rand(*shape, generator=generator, dtype=dtype) * 5 + 1e-3
    return action, loc, scale


def test_by_hand():
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


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"scale.*\[2\].*\[3, 2\]"):
        gaussian_log_prob(torch.zeros(3, 2), torch.zeros(3, 2), torch.ones(2))
