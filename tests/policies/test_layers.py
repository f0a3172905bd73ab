import math

import numpy as np
import pytest
import torch
from scipy import stats
from torchrl.envs import CatFrames

from trl_explore.envs import make_env
from trl_explore.policies import INITS, initial_weights
from trl_explore.policies.layers import n_features, spec_env


@pytest.mark.parametrize("trials", [1, 30, 400])
@pytest.mark.parametrize(("n_out", "n_in"), [(2, 4), (3, 6), (4, 16)])
def test_glorot_bound_is_that_of_one_trial(trials, n_out, n_in):
    weight = initial_weights([n_in, n_out], trials)[0]
    assert weight.shape == (trials, n_out, n_in)
    assert weight.dtype == torch.float32
    bound = math.sqrt(6 / (n_in + n_out))
    assert weight.abs().max() <= bound
    if trials == 400:
        assert weight.max() > 0.99 * bound
        assert weight.min() < -0.99 * bound


def test_glorot_of_cartpole_is_uniform_within_one():
    draws = initial_weights([4, 2], 2000)[0].flatten().numpy()  # √(6 / (4 + 2)) = 1
    assert stats.kstest(draws, stats.uniform(-1, 2).cdf).pvalue > 1e-3


def test_row_k_of_a_batch_is_trial_k_alone():
    together = initial_weights([4, 2], 30, seed=3)[0]
    for k in range(30):
        assert torch.equal(together[k], initial_weights([4, 2], 1, seed=3, first_trial=k)[0][0])
    assert torch.equal(together[7:20], initial_weights([4, 2], 13, seed=3, first_trial=7)[0])


def test_trials_and_seeds_share_no_weight():
    weights = torch.stack([initial_weights([4, 2], 30, seed=seed)[0] for seed in (0, 1, 2, 30)])
    assert len(weights.unique()) == weights.numel()


def test_weights_ignore_the_global_generators():
    with torch.random.fork_rng():
        torch.manual_seed(1)
        first = initial_weights([4, 2], 2)[0]
        state = torch.get_rng_state()
        torch.manual_seed(2)
        assert torch.equal(initial_weights([4, 2], 2)[0], first)
        torch.manual_seed(1)
        assert torch.equal(torch.get_rng_state(), state)


VARIANCES = {  # of one layer with 30 inputs and 20 outputs
    "glorot_uniform": 2 / 50,
    "glorot_normal": 2 / 50,
    "he_uniform": 2 / 30,
    "he_normal": 2 / 30,
    "lecun_normal": 1 / 30,
    "normal": 1.0,
    "orthogonal": 1 / 30,  # rows of length 1
    "zeros": 0.0,
}


@pytest.mark.parametrize("init", INITS)
def test_variances_are_those_of_the_papers(init):
    (weight,) = initial_weights([30, 20], 40, init)
    assert weight.shape == (40, 20, 30)
    assert weight.dtype == torch.float32
    assert weight.double().square().mean() == pytest.approx(VARIANCES[init], rel=0.03)
    if init != "zeros":
        assert abs(weight.double().mean()) < 4 * math.sqrt(VARIANCES[init] / weight.numel())


@pytest.mark.parametrize("init", ["glorot_normal", "he_normal", "lecun_normal", "normal"])
def test_the_normal_ones_are_normal(init):
    (weight,) = initial_weights([30, 20], 10, init)
    standard = weight.flatten().numpy() / math.sqrt(VARIANCES[init])
    assert stats.kstest(standard, stats.norm.cdf).pvalue > 1e-3


@pytest.mark.parametrize("init", ["glorot_uniform", "he_uniform"])
def test_the_uniform_ones_are_uniform(init):
    (weight,) = initial_weights([30, 20], 10, init)
    bound = math.sqrt(3 * VARIANCES[init])
    draws = weight.flatten().numpy()
    assert stats.kstest(draws, stats.uniform(-bound, 2 * bound).cdf).pvalue > 1e-3


@pytest.mark.parametrize(("n_in", "n_out"), [(8, 3), (3, 8), (5, 5)])
def test_orthogonal(n_in, n_out):
    (weight,) = initial_weights([n_in, n_out], 4, "orthogonal")
    product = weight.mT @ weight if n_out >= n_in else weight @ weight.mT
    torch.testing.assert_close(product, torch.eye(min(n_in, n_out)).expand(4, -1, -1))


def test_orthogonal_has_no_preferred_direction():
    """Of a rotation of the plane, uniformly drawn, every entry is as often negative as positive."""
    (weight,) = initial_weights([2, 2], 2000, "orthogonal")
    angle = torch.atan2(weight[:, 1, 0], weight[:, 0, 0]).numpy()
    assert stats.kstest(angle, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3
    assert stats.binomtest(int((torch.linalg.det(weight) > 0).sum()), 2000).pvalue > 1e-3


@pytest.mark.parametrize("init", INITS)
def test_layers_of_trial_k_alone(init):
    together = initial_weights([4, 7, 2], 12, init, seed=3)
    for k in (0, 5, 11):
        alone = initial_weights([4, 7, 2], 1, init, seed=3, first_trial=k)
        for layer, own in zip(together, alone, strict=True):
            assert torch.equal(layer[k], own[0])


def test_layers_trials_and_seeds_share_no_number():
    drawn = [
        layer.flatten() for seed in (0, 1) for layer in initial_weights([4, 8, 8, 2], 10, seed=seed)
    ]
    numbers = torch.cat(drawn)
    assert len(numbers.unique()) == len(numbers)


def test_output_gain_is_a_factor_of_the_last_layer():
    plain = initial_weights([4, 8, 2], 3)
    small = initial_weights([4, 8, 2], 3, output_gain=0.01)
    assert torch.equal(small[0], plain[0])
    torch.testing.assert_close(small[1], 0.01 * plain[1])


def test_what_does_not_exist():
    with pytest.raises(ValueError, match=r"^init.*glorot_uniform, .*'glorot'"):
        initial_weights([4, 2], 3, "glorot")
    with pytest.raises(ValueError, match=r"^output_gain.*>= 0.*-1"):
        initial_weights([4, 2], 3, output_gain=-1)
    for size in (0, -3, 2.5, True, "4"):
        with pytest.raises(ValueError, match=f"layer.*>= 1.*{size}"):
            initial_weights([4, size, 2], 3)
    with pytest.raises(ValueError, match=r"layer.*<= 1000000.*10000000"):
        initial_weights([4, 10**7, 2], 3)


def test_specs_come_from_before_the_counting_transforms_unless_others_change_them():
    plain, stacked = (
        make_env(trials=2),
        make_env(trials=2, transforms=[CatFrames(3, dim=-1, in_keys=["observation"])]),
    )
    assert spec_env(plain) is plain.base_env
    assert spec_env(stacked) is stacked
    assert spec_env(plain.base_env) is plain.base_env
    for env in (plain, stacked):
        assert spec_env(env).action_spec == env.action_spec
        expected = env.observation_spec["observation"]
        assert spec_env(env).observation_spec["observation"] == expected
    assert (n_features(plain), n_features(stacked)) == (4, 12)
