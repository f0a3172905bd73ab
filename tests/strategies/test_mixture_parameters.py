"""Parameters of mixtures that follow schedules, or that have one value for each trial."""

import math

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModuleBase

from tests.strategies.mixtures import NEVER, PREFERENCES, close
from trl_explore.strategies import (
    DecayingEpsilonGreedy,
    EpsilonGreedy,
    FullMixture,
    Softmax,
)
from trl_explore.strategies.schedules import Constant, Exponential, Linear, Piecewise


def test_weights_follow_schedules_and_sum_to_one_in_every_iteration():
    strategy = FullMixture(
        Linear(0.0, 1.0, 10), Exponential(2.0, 0.5), Piecewise([(0, 1.0), (3, 0.0)]), [1.0, 2.0]
    )
    shares = []
    for _ in range(30):
        greedy, softmax, uniform, _ = strategy.mixture()
        shares.append((greedy, softmax, uniform))
        strategy.step()
    np.testing.assert_allclose(np.sum(shares, axis=1), 1, rtol=1e-15)
    np.testing.assert_allclose(shares[0], [0, 2 / 3, 1 / 3])
    np.testing.assert_allclose(shares[3], np.array([0.3, 0.25, 0]) / 0.55)


def test_weights_per_trial():
    strategy = FullMixture(greedy=[1.0, 0.0], softmax=0.0, uniform=[1.0, 4.0])
    probs = strategy.probs(torch.tensor([[0.0, 1.0]] * 2), torch.tensor([1, 0]))
    close(probs, [[0.5, 0.5], [0.25, 0.75]])
    with pytest.raises(ValueError, match=r"weights.*\[2, 3\]"):
        FullMixture(greedy=[1.0, 0.0], softmax=0.0, uniform=[1.0, 4.0, 1.0])


def uniform_share(strategy, iterations):
    """The weight of uniform in each iteration, read off the action of least preference."""
    shares = []
    for _ in range(iterations):
        shares.append(4 * strategy.probs(PREFERENCES)[0].item())
        strategy.step()
    return shares


@pytest.mark.parametrize("decay", [0.99, 0.9, 0.5])
def test_decay_is_gamma_to_the_i_from_iteration_zero(decay):
    shares = uniform_share(DecayingEpsilonGreedy(decay), 6)
    expected = [1, decay, decay**2, decay**3, decay**4, decay**5]
    np.testing.assert_allclose(shares, expected, rtol=1e-12)


def test_decay_is_one_percent_after_458_iterations():
    strategy = DecayingEpsilonGreedy()  # 0.99^458 = 0.0100212
    shares = uniform_share(strategy, 460)
    assert shares[458] == pytest.approx(0.0100212, rel=1e-5)
    assert shares[459] < 0.01 < shares[458]


def test_decay_does_not_count_frames():
    strategy = DecayingEpsilonGreedy(0.5)
    for _ in range(10):
        strategy.probs(torch.zeros(100, 2))
    assert uniform_share(strategy, 2) == [1, 0.5]


def test_decay_at_its_ends():
    assert uniform_share(DecayingEpsilonGreedy(1), 3) == [1, 1, 1]
    assert uniform_share(DecayingEpsilonGreedy(0), 3) == [1, 0, 0]
    last = DecayingEpsilonGreedy(0.99)
    last.iteration.fill_(10**6 - 1)
    last.step()
    assert last.probs(PREFERENCES).tolist() == [0, 0.5, 0, 0.5]


def test_any_schedule_serves():
    strategy = EpsilonGreedy(Linear(1.0, 0.0, iterations=4))
    np.testing.assert_allclose(uniform_share(strategy, 6), [1, 0.75, 0.5, 0.25, 0, 0], atol=1e-15)
    strategy = Softmax(Exponential(2.0, 0.5))
    logits = torch.tensor([0.0, math.log(3)], dtype=torch.float64)
    odds = []
    for _ in range(3):
        probs = strategy.probs(logits)
        odds.append((probs[1] / probs[0]).item())
        strategy.step()
    np.testing.assert_allclose(odds, [math.sqrt(3), 3, 9])


def test_epsilon_per_trial():
    strategy = EpsilonGreedy([0.0, 0.2, 1.0])
    trial = torch.tensor([2, 1, 0, 1])
    expected = torch.stack(
        [EpsilonGreedy(epsilon).probs(PREFERENCES) for epsilon in (1.0, 0.2, 0.0, 0.2)]
    )
    torch.testing.assert_close(strategy.probs(PREFERENCES.expand(4, 4), trial), expected)
    stacked = strategy.probs(PREFERENCES.expand(2, 2, 4), trial.reshape(2, 2))
    torch.testing.assert_close(stacked, expected.reshape(2, 2, 4))


@pytest.mark.parametrize("values", [[0.5, 1.0, 2.0], (0.5, 1, 2), np.array([0.5, 1.0, 2.0])])
def test_temperature_per_trial(values):
    logits = torch.tensor([0.0, math.log(3)]).expand(3, 2)
    probs = Softmax(values).probs(logits, torch.tensor([1, 0, 2]))
    root = math.sqrt(3)
    close(probs, [[0.25, 0.75], [0.1, 0.9], [1 / (1 + root), root / (1 + root)]])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_extreme_temperatures_per_trial(dtype):
    logits = torch.tensor([NEVER, 1.0, 2.0, 2.0], dtype=dtype).expand(3, 4)
    probs = Softmax([1e-300, 1e-30, 1e300]).probs(logits, torch.tensor([0, 1, 2]))
    close(probs, [[0, 0, 0.5, 0.5], [0, 0, 0.5, 0.5], [0, 1 / 3, 1 / 3, 1 / 3]])


def test_temperature_per_trial_as_a_schedule():
    logits = torch.tensor([0.0, math.log(3)]).expand(2, 2)
    probs = Softmax(Constant([0.5, 1.0])).probs(logits, torch.tensor([1, 0]))
    close(probs, [[0.25, 0.75], [0.1, 0.9]])


def test_values_per_trial_need_the_trial():
    with pytest.raises(ValueError, match="'trial'"):
        EpsilonGreedy([0.1, 0.2]).probs(PREFERENCES)


def test_values_per_trial_have_to_be_one_for_each():
    strategy = EpsilonGreedy([0.1, 0.2])
    strategy.bind(TensorDictModuleBase(), 2)
    for trials in (1, 3):
        with pytest.raises(ValueError, match=rf"^epsilon has 2 values.*{trials} trials"):
            strategy.bind(TensorDictModuleBase(), trials)
    EpsilonGreedy(0.1).bind(TensorDictModuleBase(), 7)
    with pytest.raises(ValueError, match=r"^temperature has 1 values.*2 trials"):
        Softmax([1.0]).bind(TensorDictModuleBase(), 2)
