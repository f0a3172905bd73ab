"""The distributions of the continuous strategies, against scipy and TorchRL."""

import numpy as np
import pytest
import torch
from scipy import stats
from torchrl.data import Bounded
from torchrl.modules import TanhNormal

from tests.strategies.continuous import BOX, HIGH, LOC, LOW, SCALE, build, density, frames
from trl_explore.strategies import (
    EpsilonMean,
    EpsilonUniform,
    Gaussian,
    MeanAction,
    UniformAction,
)
from trl_explore.strategies.schedules import Exponential


@pytest.fixture(autouse=True)
def seeded():
    """A test of a distribution must not fail by chance in one of a hundred runs."""
    torch.manual_seed(0)


@pytest.mark.parametrize("name", ["gaussian", "uniform_action", "epsilon_uniform"])
def test_log_prob_is_the_density_of_scipy(name):
    data = build(name)(frames(2000))
    assert data["action_log_prob"].shape == (2000,)
    expected = density(name, data["action"])
    np.testing.assert_allclose(data["action_log_prob"], expected, rtol=1e-5, atol=1e-5)


def test_density_outside_of_the_box():
    outside = torch.tensor([[5.0, 0.6], [0.0, 0.4], [-1.0, 0.5]])  # the last is a corner: inside
    loc, scale = LOC.expand(3, 2), SCALE.expand(3, 2)
    mixed = build("epsilon_uniform").log_prob(outside, loc, scale)
    np.testing.assert_allclose(mixed, density("epsilon_uniform", outside), rtol=1e-5)
    uniform = build("uniform_action").log_prob(outside, loc, scale)
    assert uniform.tolist()[:2] == [-np.inf, -np.inf]
    assert uniform[2].item() == pytest.approx(-np.log(4 * 0.25), abs=1e-6)


@pytest.mark.parametrize("name", ["gaussian", "uniform_action", "epsilon_uniform"])
def test_the_density_integrates_to_one(name):
    x = torch.linspace(-6, 8, 2801, dtype=torch.float64) + 1e-4
    one = Bounded(-1.0, 3.0, shape=(1,))
    loc, scale = torch.full((2801, 1), 0.3).double(), torch.full((2801, 1), 0.7).double()
    log_prob = build(name, spec=one).log_prob(x.unsqueeze(-1), loc, scale)
    assert float(log_prob.exp().sum() * 14 / 2800) == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("temperature", [0.5, 1.0, 3.0])
def test_temperature_multiplies_the_scale(temperature):
    data = Gaussian(temperature)(frames(4000))
    for j in range(2):
        normal = stats.norm(LOC[j].item(), temperature * SCALE[j].item())
        assert stats.kstest(data["action"][:, j].numpy(), normal.cdf).pvalue > 1e-3
    wide = temperature * SCALE.double()
    expected = stats.norm.logpdf(data["action"].double(), LOC.double(), wide).sum(-1)
    np.testing.assert_allclose(data["action_log_prob"], expected, rtol=1e-4, atol=1e-5)


def test_temperature_of_a_schedule_that_falls_to_zero():
    strategy = Gaussian(Exponential(1.0, 0.1), spec=BOX)
    for _ in range(400):
        strategy.step()
    data = strategy(frames(50))
    torch.testing.assert_close(data["action"], LOC.expand(50, 2), atol=1e-4, rtol=0)
    assert data["action_log_prob"].isfinite().all()


def test_uniform_fills_the_box():
    action = UniformAction(spec=BOX)(frames(5000))["action"]
    for j in range(2):
        uniform = stats.uniform(LOW[j].item(), (HIGH - LOW)[j].item())
        assert stats.kstest(action[:, j].numpy(), uniform.cdf).pvalue > 1e-3
    assert abs(stats.pearsonr(*action.numpy().T).statistic) < 0.05


def test_epsilon_is_the_share_of_uniform_frames():
    # 0.0 is the mean; a uniform draw hits it with probability 0.
    mean = EpsilonMean(0.3, spec=BOX)(frames(10_000))["action"]
    explored = int((mean != LOC).all(-1).sum())
    assert int((mean == LOC).all(-1).sum()) == 10_000 - explored
    assert stats.binomtest(explored, 10_000, 0.3).pvalue > 1e-3
    drawn = mean[(mean != LOC).all(-1), 0].numpy()
    assert stats.kstest(drawn, stats.uniform(-1, 4).cdf).pvalue > 1e-3


def test_epsilon_uniform_is_distributed_as_its_mixture():
    action = EpsilonUniform(0.3, spec=BOX)(frames(5000))["action"]
    for j in range(2):
        normal = stats.norm(LOC[j].item(), SCALE[j].item())
        uniform = stats.uniform(LOW[j].item(), (HIGH - LOW)[j].item())

        def cdf(x, normal=normal, uniform=uniform):
            return 0.7 * normal.cdf(x) + 0.3 * uniform.cdf(x)

        assert stats.kstest(action[:, j].numpy(), cdf).pvalue > 1e-3


def test_mean_action_is_the_mean():
    data = MeanAction()(frames(5))
    assert torch.equal(data["action"], LOC.expand(5, 2))


@pytest.mark.parametrize("cls", [MeanAction, EpsilonMean])
def test_without_a_density_none_is_written(cls):
    strategy = cls(spec=BOX)
    assert not strategy.exact
    assert strategy.out_keys == ["action"]
    assert "action_log_prob" not in strategy(frames(5))
    with pytest.raises(ValueError, match=f"{cls.__name__}.*density"):
        strategy.log_prob(LOC, LOC, SCALE)


@pytest.mark.parametrize("name", ["gaussian", "uniform_action", "epsilon_uniform"])
def test_log_prob_is_differentiable_as_it_says(name):
    strategy = build(name)
    action = strategy(frames(8))["action"].double()
    loc, scale = (x.double().expand(8, 2).clone().requires_grad_() for x in (LOC, SCALE))
    if name == "uniform_action":  # a constant
        assert strategy.differentiable
        return
    assert torch.autograd.gradcheck(lambda *x: strategy.log_prob(action, *x), (loc, scale))
    assert strategy.differentiable


@pytest.mark.parametrize(("epsilon", "temperature"), [(None, 1.0), (None, 0.5), (0.3, 1.0)])
def test_a_squashed_policy_is_torchrls_tanh_normal(epsilon, temperature):
    torch.manual_seed(0)
    loc, scale = LOC.expand(5000, 2), SCALE.expand(5000, 2)
    given = {"spec": BOX, "squashed": True}
    strategy = Gaussian(temperature, **given) if epsilon is None else EpsilonUniform(0.3, **given)
    data = strategy(frames(5000))
    assert BOX.expand(5000, 2).is_in(data["action"])
    pi = TanhNormal(loc, temperature * scale, low=LOW, high=HIGH)
    inner = (data["action"] > LOW + 1e-3).all(-1) & (data["action"] < HIGH - 1e-3).all(-1)
    density = pi.log_prob(data["action"]).exp()
    if epsilon is not None:
        density = 0.7 * density + 0.3 / (HIGH - LOW).prod()
    found = data["action_log_prob"].exp()
    torch.testing.assert_close(found[inner], density[inner], rtol=1e-2, atol=1e-5)
    if epsilon is None:
        for j in range(2):
            theirs = pi.sample()[:, j].numpy()
            assert stats.ks_2samp(data["action"][:, j].numpy(), theirs).pvalue > 1e-3
