"""ε-greedy with random actions that last."""

import numpy as np
import pytest
import torch
from scipy import stats
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase

from trl_explore.strategies import EpsilonZGreedy

POLICY = TensorDictModuleBase()  # for those that do not look at it


def z_frames(noise, **entries):
    """One state of two lanes, in which action 2 of three is greedy."""
    logits = torch.tensor([[0.0, 1.0, 5.0]] * 2)
    entries = {"is_init": torch.zeros(2, 1, dtype=torch.bool)} | entries
    return TensorDict({"logits": logits, "noise": torch.tensor(noise), **entries}, [2])


def test_a_random_action_is_repeated_for_its_duration():
    # With μ = 2 and N = 3 the weights are 1, 1/4, 1/9: P(n <= 1) = 36/49, P(n <= 2) = 45/49.
    strategy = EpsilonZGreedy(0.5, max_duration=3, noise_key="noise")
    never, once = [0.6, 0.0, 0.0], [0.4, 0.5, 0.7]
    twice, thrice = [0.4, 0.5, 0.9], [0.4, 0.0, 0.99]
    steps = [[once, thrice], [never, never], [twice, never], [once, never], [never, never]]
    actions = [strategy(z_frames(noise))["action"].tolist() for noise in steps]
    assert actions == [[1, 0], [2, 0], [1, 0], [1, 2], [2, 2]]


def test_durations_are_those_of_the_zeta_distribution():
    torch.manual_seed(0)
    n = 100_000
    strategy = EpsilonZGreedy(1.0, mu=2.5)
    logits = torch.zeros(n, 4)
    strategy(TensorDict({"logits": logits, "step_count": torch.zeros(n, 1)}, [n]))
    durations = strategy._remaining.numpy() + 1
    counts = np.bincount(np.minimum(durations, 12), minlength=13)[1:]
    zeta = stats.zipf(2.5)
    expected = n * np.append(zeta.pmf(np.arange(1, 12)), zeta.sf(11))
    assert stats.chisquare(counts, expected).pvalue > 1e-3


def test_no_repetition_outlives_its_episode():
    long, never = [[0.0, 0.0, 0.999]] * 2, [[0.9, 0.0, 0.0]] * 2
    for start in ("begin", "is_init", "step_count"):
        strategy = EpsilonZGreedy(0.5, noise_key="noise")
        strategy.bind(POLICY, 2)
        assert strategy(z_frames(long))["action"].tolist() == [0, 0]
        entries = {}
        if start == "begin":
            strategy.begin(np.array([False, True]), np.zeros(2, dtype=np.int64))
        elif start == "is_init":
            entries = {"is_init": torch.tensor([[False], [True]])}
        else:
            entries = {"step_count": torch.tensor([[7], [0]])}
        assert strategy(z_frames(never, **entries))["action"].tolist() == [0, 2]


def test_a_repetition_ends_where_its_action_is_forbidden():
    strategy = EpsilonZGreedy(0.5, noise_key="noise")
    strategy(z_frames([[0.0, 0.0, 0.999]] * 2))
    mask = torch.tensor([[False, True, True], [True, True, False]])
    never = [[0.9, 0.0, 0.0]] * 2
    assert strategy(z_frames(never, action_mask=mask))["action"].tolist() == [2, 0]
    assert strategy(z_frames(never))["action"].tolist() == [2, 0]


def test_exploitation_draws_no_durations():
    strategy = EpsilonZGreedy(0.0, noise_key="noise")
    for _ in range(3):
        assert strategy(z_frames([[0.0, 0.0, 0.999]] * 2))["action"].tolist() == [2, 2]


@pytest.mark.parametrize(
    ("options", "name"),
    [({"epsilon": 1.1}, "epsilon"), ({"mu": 1.0}, "mu"), ({"max_duration": 0}, "max_duration")],
)
def test_z_greedy_refuses(options, name):
    with pytest.raises(ValueError, match=rf"^{name}\b"):
        EpsilonZGreedy(**options)
