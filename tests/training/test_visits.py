"""Where the trials have been: by hand, in shards, and after a restart."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from trl_explore.envs import make_env
from trl_explore.training.diagnostic_quantities import BINS, PLANES
from trl_explore.training.snapshots import Snapshots, Visits


def frames(states, trials, n_states=16):
    observation = torch.eye(n_states)[torch.tensor(states)]
    return TensorDict({"observation": observation, "trial": torch.tensor(trials)}, [len(states)])


def lake(trials=2):
    return Visits(make_env("FrozenLake-v1", trials=trials), trials)


def test_by_hand():
    visits = lake()
    for states in ([0, 1, 1], [0, 0, 5], [15, 15, 15], [2, 2, 2], [3, 3, 3]):
        visits.record(frames(states, [0, 0, 1]))
    found = Visits.joined([visits])
    assert found is not None
    assert found["iteration"].tolist() == [1, 2, 4, 5]
    assert found["visits"].shape == (4, 4, 4)
    assert found["visits"].sum(axis=(1, 2)).tolist() == [3, 6, 12, 15]
    assert found["visits"][1].ravel().tolist() == [3, 2, 0, 0, 0, 1] + [0] * 10
    assert found["reached"][1].ravel().tolist() == [1, 2, 0, 0, 0, 1] + [0] * 10
    assert found["reached"][-1, 3, 3] == 2


def test_shards_are_one_job():
    """A shard that stops early keeps its counts."""
    together, first, second = lake(), lake(1), lake(1)
    for k in range(6):
        states, trials = ([k, 2 * k], [0, 1]) if k < 3 else ([2 * k], [1])
        together.record(frames(states, trials))
        second.record(frames([2 * k], [0]))
        if k < 3:
            first.record(frames([k], [0]))
    found, expected = Visits.joined([first, second]), Visits.joined([together])
    assert found is not None
    assert expected is not None
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values)


def test_its_state_is_saved():
    one, two = lake(), lake()
    for k in range(5):
        one.record(frames([k], [0]))
    two.load_state_dict(one.state_dict())
    for visits in (one, two):
        visits.record(frames([9], [1]))
    found, expected = Visits.joined([two]), Visits.joined([one])
    assert found is not None
    assert expected is not None
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values)


@pytest.mark.parametrize(
    ("id", "shape"),
    [
        ("trl_explore/DeepSea-v0", (10, 10)),
        ("trl_explore/TwoRooms-v0", (5, 11)),
        ("trl_explore/RiverSwim-v0", (1, 6)),
        ("CliffWalking-v1", (4, 12)),
        ("Taxi-v4", (1, 500)),
        ("CartPole-v1", (BINS, BINS)),
    ],
)
def test_the_shape_of_the_cells(id, shape):
    assert Visits(make_env(id, max_steps=50), 1).shape == shape


def test_two_features_across_and_up():
    visits = Visits(make_env("CartPole-v1"), 1)
    across, up = PLANES["CartPole-v1"]
    observation = torch.zeros(3, 4)
    observation[1, across.index], observation[1, up.index] = across.high + 9, up.low
    observation[2, across.index], observation[2, up.index] = across.low, up.high - 1e-6
    visits.record(TensorDict({"observation": observation, "trial": torch.zeros(3).long()}, [3]))
    found = Visits.joined([visits])
    assert found is not None
    (seen,) = found["visits"]
    assert [*zip(*np.nonzero(seen), strict=True)] == [(0, 31), (16, 16), (31, 0)]


def test_an_environment_without_states_and_named_features_has_none():
    visits = Visits(make_env("trl_explore/Catch-v0", max_steps=10), 1)
    observation = torch.zeros(2, 50)
    visits.record(TensorDict({"observation": observation, "trial": torch.zeros(2).long()}, [2]))
    assert Visits.joined([visits]) is None


def test_a_resumed_training_keeps_the_weights_that_it_was_asked_for_at_first():
    policy = torch.nn.Linear(1, 1)
    first, resumed = Snapshots(policy, [2, 5], 9), Snapshots(policy, [3], 9)
    first.record(2)
    resumed.load_state_dict(first.state_dict())
    for iteration in (3, 4, 5):
        resumed.record(iteration)
    assert sorted(resumed.kept) == [2, 5]
