"""μ of mixtures of argmax, softmax and uniform: numbers worked out by hand, and limits."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.strategies.mixtures import NEVER, PREFERENCES, close
from trl_explore.strategies import (
    Argmax,
    DecayingEpsilonGreedy,
    EpsilonGreedy,
    EpsilonSoftmax,
    FullMixture,
    MaxBoltzmann,
    Mixture,
    Random,
    Softmax,
    mixture_probs,
)

finite_logits = st.lists(st.floats(-50, 50), min_size=1, max_size=6)
unit = st.floats(0, 1)


def test_argmax_shares_ties():
    assert Argmax().probs(PREFERENCES).tolist() == [0, 0.5, 0, 0.5]
    assert Argmax().probs(torch.tensor([1.0, 3.0, 2.0])).tolist() == [0, 1, 0]
    close(Argmax().probs(torch.zeros(3)), [1 / 3] * 3)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_only_equal_preferences_are_ties(dtype):
    most = torch.tensor(4.0, dtype=dtype)
    almost = torch.nextafter(most, torch.zeros_like(most))
    for logits in (torch.stack([almost, most]), torch.stack([-most, -almost])):
        assert Argmax().probs(logits).tolist() == [0, 1]
        close(EpsilonGreedy(0.2).probs(logits), [0.1, 0.9])


def test_random_is_uniform():
    assert Random().probs(PREFERENCES).tolist() == [0.25] * 4


def test_epsilon_greedy():
    close(EpsilonGreedy(0.2).probs(PREFERENCES), [0.05, 0.45, 0.05, 0.45])
    close(EpsilonGreedy(0.3).probs(torch.tensor([1.0, 2.0])), [0.15, 0.85])


@pytest.mark.parametrize("temperature", [0.5, 1.0, 2.0, 100.0])
def test_softmax_at_a_temperature(temperature):
    logits = temperature * torch.tensor([0.0, math.log(3), math.log(4)], dtype=torch.float64)
    close(Softmax(temperature).probs(logits), [1 / 8, 3 / 8, 4 / 8])


def test_softmax_of_the_thesis_is_at_temperature_one():
    logits = torch.tensor([0.0, math.log(3)])
    close(Softmax().probs(logits), [0.25, 0.75])
    close(Softmax(2.0).probs(logits), [1 / (1 + math.sqrt(3)), math.sqrt(3) / (1 + math.sqrt(3))])
    close(Softmax(0.5).probs(logits), [0.1, 0.9])


def test_mixture_of_all_three_corners():
    mixture = Mixture(greedy=0.5, softmax=0.3, uniform=0.2, temperature=2.0)
    logits = torch.tensor([0.0, 2 * math.log(3)])
    close(mixture_probs(logits, mixture), [0.3 / 4 + 0.1, 0.5 + 0.9 / 4 + 0.1])
    masked = torch.tensor([0.0, NEVER, 2 * math.log(3)])
    close(mixture_probs(masked, mixture), [0.3 / 4 + 0.1, 0, 0.5 + 0.9 / 4 + 0.1])


def test_max_boltzmann():
    logits = torch.tensor([0.0, math.log(3), -math.inf])
    close(MaxBoltzmann(0.4).probs(logits), [0.1, 0.9, 0])
    close(MaxBoltzmann(0.4, temperature=0.5).probs(logits), [0.04, 0.96, 0])
    close(MaxBoltzmann(0.4, temperature=1e30).probs(logits), [0.2, 0.8, 0])  # ε-greedy
    assert MaxBoltzmann(1.0).mixture() == Softmax().mixture()


def test_epsilon_softmax():
    logits = torch.tensor([0.0, math.log(3), -math.inf])
    close(EpsilonSoftmax(0.2).probs(logits), [0.3, 0.7, 0])
    close(EpsilonSoftmax(0.2, temperature=0.5).probs(logits), [0.18, 0.82, 0])
    assert EpsilonSoftmax(0.0).mixture() == Softmax().mixture()


@pytest.mark.parametrize("epsilon", [0.05, 0.3, 0.9])
def test_the_ratio_to_epsilon_softmax_is_bounded(epsilon):
    logits = torch.randn(100, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    ratio = Softmax().probs(logits) / EpsilonSoftmax(epsilon).probs(logits)
    assert (ratio <= 1 / (1 - epsilon) + 1e-12).all()


def test_full_mixture_divides_by_the_sum_of_the_weights():
    logits = torch.tensor([0.0, 2 * math.log(3)])
    expected = [0.3 / 4 + 0.1, 0.5 + 0.9 / 4 + 0.1]
    close(FullMixture(0.5, 0.3, 0.2, temperature=2.0).probs(logits), expected)
    close(FullMixture(5, 3, 2, temperature=2.0).probs(logits), expected)
    assert FullMixture(0.75, 0, 0.25).mixture() == EpsilonGreedy(0.25).mixture()


def test_which_mixtures_are_differentiable_in_the_logits():
    smooth = [Softmax(2.0), Random(), EpsilonSoftmax(0.3), FullMixture(greedy=0.0)]
    rough = [Argmax(), EpsilonGreedy(0.3), MaxBoltzmann(0.3), FullMixture()]
    assert [s.differentiable for s in (*smooth, *rough)] == [True] * 4 + [False] * 4


def test_a_forbidden_action_leaves_its_share_to_the_others():
    logits = torch.tensor([0.0, NEVER, 3.0])
    assert Random().probs(logits).tolist() == [0.5, 0, 0.5]
    close(EpsilonGreedy(0.2).probs(logits), [0.1, 0, 0.9])
    close(Softmax(3.0).probs(logits), [1 / (1 + math.e), 0, math.e / (1 + math.e)])
    assert Argmax().probs(logits).tolist() == [0, 0, 1]


def test_mixtures_of_the_five_strategies():
    assert Random().mixture() == Mixture(uniform=1.0)
    assert Argmax().mixture() == Mixture(greedy=1.0)
    assert Softmax(0.7).mixture() == Mixture(softmax=1.0, temperature=0.7)
    assert EpsilonGreedy(0.25).mixture() == Mixture(greedy=0.75, uniform=0.25)
    assert DecayingEpsilonGreedy(0.5).mixture() == Mixture(greedy=0.0, uniform=1.0)


@settings(deadline=None, derandomize=True)
@given(finite_logits, unit, unit, st.floats(1e-3, 1e3))
def test_mixture_is_a_distribution(values, a, b, temperature):
    low, high = sorted((a, b))
    mixture = Mixture(low, high - low, 1 - high, temperature)
    logits = torch.tensor(values, dtype=torch.float64)
    probs = mixture_probs(logits, mixture)
    assert (probs >= 0).all()
    assert probs.sum().item() == pytest.approx(1)
    shifted = mixture_probs(logits + 1024, mixture)  # preferences have no zero
    if logits.unique().numel() == (logits + 1024).unique().numel():
        torch.testing.assert_close(shifted, probs, rtol=1e-6, atol=1e-6)


def test_epsilon_at_its_limits():
    assert torch.equal(EpsilonGreedy(0).probs(PREFERENCES), Argmax().probs(PREFERENCES))
    assert torch.equal(EpsilonGreedy(1).probs(PREFERENCES), Random().probs(PREFERENCES))
    close(EpsilonGreedy(1e-12).probs(PREFERENCES), [0, 0.5, 0, 0.5], rtol=0, atol=1e-11)
    close(EpsilonGreedy(1 - 1e-12).probs(PREFERENCES), [0.25] * 4, rtol=0, atol=1e-11)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("temperature", [1e-3, 1e-30, 1e-300, 5e-324])
def test_cold_softmax_is_argmax(temperature, dtype):
    for scale in (1.0, 1e30):
        probs = Softmax(temperature).probs(scale * PREFERENCES.to(dtype))
        assert probs.tolist() == [0, 0.5, 0, 0.5]
    masked = Softmax(temperature).probs(torch.tensor([NEVER, 1.0, 2.0], dtype=dtype))
    assert masked.tolist() == [0, 0, 1]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("temperature", [1e10, 1e30, 1e300])
def test_hot_softmax_is_uniform(temperature, dtype):
    close(Softmax(temperature).probs(PREFERENCES.to(dtype)), [0.25] * 4)
    masked = Softmax(temperature).probs(torch.tensor([NEVER, 1.0, 2.0], dtype=dtype))
    close(masked, [0, 0.5, 0.5])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_large_logits_do_not_overflow(dtype):
    logits = torch.tensor([1e30, 1e30, -1e30], dtype=dtype)
    for strategy in (Softmax(), Argmax(), EpsilonGreedy(0.0)):
        assert strategy.probs(logits).tolist() == [0.5, 0.5, 0]


@pytest.mark.parametrize("strategy", [Argmax(), Random(), Softmax(2.0), EpsilonGreedy(0.1)])
def test_precision_is_that_of_the_logits(strategy):
    double = strategy.probs(PREFERENCES)
    single = strategy.probs(PREFERENCES.float())
    assert (double.dtype, single.dtype) == (torch.float64, torch.float32)
    assert abs(double.sum().item() - 1) < 1e-15
    torch.testing.assert_close(single.double(), double, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "mixture",
    [
        Mixture(greedy=1.0),
        Mixture(uniform=1.0),
        Mixture(greedy=0.7, uniform=0.3),
        Mixture(greedy=0.7, softmax=0.3, temperature=0.5),
        Mixture(greedy=0.5, softmax=0.3, uniform=0.2),
    ],
)
def test_ties_masks_and_diverged_rows_do_not_touch_their_neighbours(mixture, dtype):
    rows = [[1, 2, 3], [4, 4, 0], [1, 5, -1], [math.nan, 0, 1], [-math.inf, 2, 2]]
    logits = torch.tensor(rows, dtype=dtype)
    alone = [mixture_probs(row, mixture) for row in logits]
    assert torch.allclose(alone[0].sum(), torch.ones((), dtype=dtype))
    for number in range(1, len(rows) + 1):
        found = mixture_probs(logits[:number], mixture)
        assert torch.equal(found.nan_to_num(-1), torch.stack(alone[:number]).nan_to_num(-1))
