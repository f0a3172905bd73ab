import numpy as np
import pytest
import torch

from tests.objectives.episodes import discount_rewards
from trl_explore.numerics.returns import return_to_go

# float64 is compiled where trials are given; nothing is compiled for complex numbers.
DTYPES = [torch.float32, torch.float64, torch.complex128]
VECTORS = [
    [1.0],
    [1.0, 1.0, 1.0],
    [0.0, 0.0, 0.0, 5.0],
    [5.0, 0.0, 0.0, 0.0],
    [-1.0, 2.0, -3.0, 0.5, 4.0],
    np.random.default_rng(1).normal(size=500).tolist(),
    [1.0] * 200,
]


def ends(*frames, size):
    done = torch.zeros(size, dtype=torch.bool)
    done[list(frames)] = True
    return done


def test_by_hand():
    reward = torch.tensor([1.0, 2.0, 3.0])
    assert return_to_go(reward, ends(2, size=3), 0.5).tolist() == [2.75, 3.5, 3.0]


def test_a_done_frame_ends_the_sum_and_keeps_its_own_reward():
    reward = torch.tensor([1.0, 2.0, 4.0, 8.0, 16.0])
    returns = return_to_go(reward, ends(1, 3, size=5), 0.5)
    assert returns.tolist() == [2.0, 2.0, 8.0, 8.0, 16.0]


def test_nothing_follows_the_last_frame():
    reward = torch.tensor([1.0, 2.0])
    for last in (True, False):
        done = torch.tensor([False, last])
        assert return_to_go(reward, done, 0.5).tolist() == [2.0, 2.0]


@pytest.mark.parametrize("gamma", [0.0, 0.5, 0.9, 0.99, 1.0])
@pytest.mark.parametrize("vector", VECTORS, ids=len)
def test_agrees_with_the_thesis(vector, gamma):
    done = ends(-1, size=len(vector))
    expected = discount_rewards(np.array(vector), gamma)
    returns = return_to_go(torch.tensor(vector, dtype=torch.float64), done, gamma)
    np.testing.assert_allclose(returns.numpy(), expected, rtol=1e-13, atol=1e-13)
    single = return_to_go(torch.tensor(vector), done, gamma)
    assert single.dtype == torch.float32
    np.testing.assert_allclose(single.numpy(), expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("gamma", [0.0, 0.5, 0.9, 0.99, 1.0])
@pytest.mark.parametrize("vector", VECTORS, ids=len)
def test_compiled_returns_agree_with_the_thesis(vector, gamma):
    done, trial = ends(-1, size=len(vector)), torch.zeros(len(vector), dtype=torch.int64)
    rewards = torch.tensor(vector)
    # In float32 only the result is rounded, not the sum on the way.
    single = return_to_go(rewards, done, gamma, trial)
    assert single.dtype == torch.float32
    expected = discount_rewards(rewards.double().numpy(), gamma)
    np.testing.assert_array_equal(single.numpy(), expected.astype(np.float32))
    double = return_to_go(rewards.double(), done, gamma, trial)
    np.testing.assert_array_equal(double.numpy(), expected)


@pytest.mark.parametrize("dtype", DTYPES)
def test_another_trial_is_not_the_future(dtype):
    reward = torch.tensor([1.0, 2.0, 4.0, 8.0, 16.0, 32.0], dtype=dtype)
    trial, done = torch.tensor([0, 0, 2, 2, 1, 0]), torch.zeros(6, dtype=torch.bool)
    returns = return_to_go(reward, done, 0.5, trial)
    assert returns.real.tolist() == [2.0, 2.0, 8.0, 8.0, 16.0, 32.0]
    assert not done.any()
    done[2] = True
    assert return_to_go(reward, done, 0.5, trial).real.tolist() == [2.0, 2.0, 4.0, 8.0, 16.0, 32.0]


def test_gamma_zero_and_one():
    reward = torch.tensor([3.0, -1.0, 2.0])
    assert return_to_go(reward, ends(2, size=3), 0.0).tolist() == [3.0, -1.0, 2.0]
    assert return_to_go(reward, ends(2, size=3), 1.0).tolist() == [4.0, 1.0, 2.0]


@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16])
def test_rows_of_a_batch_are_separate(shape, dtype):
    torch.manual_seed(0)
    reward = torch.randint(-3, 4, (*shape, 7)).to(dtype)
    done = torch.rand(*shape, 7) < 0.3
    returns = return_to_go(reward, done, 0.5)  # exact in every dtype for so few frames
    assert returns.dtype == dtype
    assert returns.shape == reward.shape
    for index in np.ndindex(*shape):
        expected = [0.0] * 7
        for t in range(7):
            for j in range(t, 7):
                expected[t] += 0.5 ** (j - t) * float(reward[index][j])
                if done[index][j]:
                    break
        tolerance = 0.05 if dtype == torch.bfloat16 else 0
        np.testing.assert_allclose(returns[index].float(), expected, atol=tolerance)


@pytest.mark.parametrize("gamma", [0.0, 0.97, 1.0])
def test_compiled_and_plain_agree(gamma):
    torch.manual_seed(1)
    reward, done = torch.randn(200, dtype=torch.float64), torch.rand(200) < 0.1
    trial = torch.arange(200) // 30
    compiled = return_to_go(reward, done, gamma, trial)
    plain = return_to_go(reward.to(torch.complex128), done, gamma, trial)
    torch.testing.assert_close(plain.real, compiled, rtol=1e-13, atol=1e-13)


def test_layout_in_memory_does_not_matter():
    torch.manual_seed(2)
    reward, done = torch.randn(6, 4), torch.rand(6, 4) < 0.3
    expected = return_to_go(reward.T.contiguous(), done.T.contiguous(), 0.9)
    assert torch.equal(return_to_go(reward.T, done.T, 0.9), expected)


@pytest.mark.parametrize("trial", [None, torch.zeros(3, dtype=torch.int64)])
def test_inputs_are_left_alone_and_no_gradient_flows(trial):
    reward = torch.ones(3)
    done = ends(2, size=3)
    returns = return_to_go(reward, done, 0.9, trial)
    assert not returns.requires_grad
    assert reward.tolist() == [1.0] * 3
    assert done.tolist() == [False, False, True]


@pytest.mark.parametrize("shape", [(0,), (3, 0), (0, 4)])
def test_no_frames(shape):
    done = torch.zeros(shape, dtype=torch.bool)
    assert return_to_go(torch.ones(shape), done, 0.9).shape == shape


def test_no_frames_of_no_trial():
    nothing = torch.zeros(0)
    assert return_to_go(nothing, nothing.bool(), 0.9, nothing.long()).shape == (0,)


def test_shapes_that_do_not_fit():
    reward, done, trial = torch.ones(6), torch.zeros(6).bool(), torch.zeros(6).long()
    for arguments in ((reward, done[:-1]), (reward, done[:-1], trial), (reward, done, trial[:-1])):
        with pytest.raises((ValueError, RuntimeError, IndexError)):
            return_to_go(*arguments[:2], 0.9, *arguments[2:])
