import math

import pytest
import torch

from trl_explore.numerics.compiled import surrogate
from trl_explore.numerics.layers import lane_sum
from trl_explore.numerics.surrogate import linear_softmax_gradient, linear_softmax_surrogate


def plain(observation, weight, action, advantage, trial):
    """The formula, frame by frame."""
    total = [weight.new_zeros(()) for _ in weight]
    for x, a, factor, k in zip(observation, action, advantage, trial.tolist(), strict=True):
        total[k] = total[k] + factor * (weight[k] @ x).log_softmax(-1)[a]
    return torch.stack(total)


def problem(frames=60, trials=4, n_actions=3, n_features=5, dtype=torch.float64):
    torch.manual_seed(0)
    return (
        torch.randn(frames, n_features, dtype=dtype),
        torch.randn(trials, n_actions, n_features, dtype=dtype),
        torch.randint(n_actions, (frames,)),
        torch.randn(frames, dtype=dtype),
        torch.randint(trials, (frames,)),
    )


def value_and_gradient(function, observation, weight, action, advantage, trial):
    leaf = weight.clone().requires_grad_()
    value = function(observation, leaf, action, advantage, trial)
    value.backward(torch.arange(1.0, len(weight) + 1).to(value.dtype))
    return value.detach(), leaf.grad


def test_lane_sum_by_hand():
    values, trial = torch.tensor([1.0, 2.0, 4.0, 8.0]), torch.tensor([1, 0, 1, 3])
    assert lane_sum(values, trial, 5).tolist() == [2.0, 5.0, 0.0, 8.0, 0.0]


@pytest.mark.parametrize("n_actions", [2, 3])
def test_by_hand(n_actions):
    # Logits 0 and ln 3 (and a third action that is all but impossible).
    weight = torch.tensor([[0.0], [math.log(3)], [-1e3]])[:n_actions].repeat(2, 1, 1)
    action, trial = torch.tensor([1, 0, 1]), torch.tensor([0, 0, 1])
    advantage = torch.tensor([2.0, 3.0, 5.0])
    value, gradient = value_and_gradient(
        linear_softmax_surrogate, torch.ones(3, 1), weight, action, advantage, trial
    )
    expected = [2 * math.log(0.75) + 3 * math.log(0.25), 5 * math.log(0.75)]
    torch.testing.assert_close(value, torch.tensor(expected))
    # 2 (0.25) + 3 (-0.75), and twice 5 (0.25).
    torch.testing.assert_close(gradient[:, 1, 0], torch.tensor([-1.75, 2.5]))
    torch.testing.assert_close(gradient[:, 0, 0], torch.tensor([1.75, -2.5]))


@pytest.mark.parametrize("n_actions", [1, 2, 3, 6])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_value_and_gradient_are_those_of_the_formula(n_actions, dtype):
    given = problem(n_actions=n_actions)
    expected = value_and_gradient(plain, *given)
    given = [x.to(dtype) if x.is_floating_point() else x for x in given]
    tolerance = 1e-4 if dtype == torch.float32 else 1e-12
    for observation in (given[0], given[0].clone().requires_grad_()):  # compiled, plain
        found = value_and_gradient(linear_softmax_surrogate, observation, *given[1:])
        for ours, theirs in zip(found, expected, strict=True):
            assert ours.dtype == dtype
            torch.testing.assert_close(ours.double(), theirs, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("n_actions", [2, 3])
def test_gradcheck(n_actions):
    observation, weight, action, advantage, trial = problem(frames=8, n_actions=n_actions)
    assert torch.autograd.gradcheck(
        lambda w: linear_softmax_surrogate(observation, w, action, advantage, trial),
        weight.requires_grad_(),
    )


def test_advantages_of_another_dtype():
    given = list(problem(dtype=torch.float32))
    expected = value_and_gradient(plain, *given)
    given[3] = given[3].double()
    found = value_and_gradient(linear_softmax_surrogate, *given)
    torch.testing.assert_close(found[0].float(), expected[0], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(found[1], expected[1], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("n_actions", [2, 3])
@pytest.mark.parametrize("scale", [1e3, 1e30])
def test_large_logits_neither_overflow_nor_vanish(n_actions, scale):
    weight = torch.full((1, n_actions, 1), -scale)
    weight[0, 0] = scale
    trial = torch.zeros(2, dtype=torch.int64)
    value, gradient = value_and_gradient(
        linear_softmax_surrogate,
        torch.ones(2, 1),
        weight,
        torch.tensor([0, 1]),
        torch.tensor([5.0, 1.0]),
        trial,
    )
    torch.testing.assert_close(value, torch.tensor([-2 * scale]))
    assert gradient[0, :2, 0].tolist() == [-1.0, 1.0]


@pytest.mark.parametrize("n_actions", [2, 3])
def test_nan_stays_in_its_trial(n_actions):
    given = problem(n_actions=n_actions)
    given[1][2, 1] = torch.nan
    value, gradient = value_and_gradient(linear_softmax_surrogate, *given)
    assert value.isnan().tolist() == [False, False, True, False]
    assert gradient.flatten(1).isnan().any(-1).tolist() == [False, False, True, False]


@pytest.mark.parametrize(
    ("n_actions", "action", "trial"),
    [(n, *place) for n in (2, 3) for place in ((-1, 0), (n, 0), (0, -1), (0, 4))],
)
def test_out_of_range(n_actions, action, trial):
    observation, weight, actions, advantage, trials = problem(n_actions=n_actions)
    actions[7], trials[7] = action, trial
    with pytest.raises(IndexError, match=r"action.*\[0, .\).*trial.*\[0, 4\)"):
        linear_softmax_surrogate(observation, weight, actions, advantage, trials)


@pytest.mark.parametrize("n_actions", [2, 3])
def test_a_trial_does_not_depend_on_its_neighbours(n_actions):
    given = problem(frames=600, trials=30, n_actions=n_actions, dtype=torch.float32)
    observation, weight, action, advantage, trial = given
    together = linear_softmax_surrogate(
        observation, weight.requires_grad_(), action, advantage, trial
    )
    (gradient,) = torch.autograd.grad(together.sum(), weight)
    for k in range(30):
        rows = trial == k
        own = weight[[k]].detach().requires_grad_()
        zero = torch.zeros(int(rows.sum()), dtype=torch.int64)
        alone = linear_softmax_surrogate(
            observation[rows], own, action[rows], advantage[rows], zero
        )
        assert torch.equal(alone[0], together[k])
        assert torch.equal(torch.autograd.grad(alone.sum(), own)[0][0], gradient[k])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("sparse", [True, False])
def test_passing_over_zeros_changes_no_bit(sparse, dtype, monkeypatch):
    given = list(problem(frames=600, n_actions=4, n_features=16, dtype=dtype))
    if sparse:
        state = torch.randint(16, (600,), generator=torch.Generator().manual_seed(1))
        given[0] = torch.nn.functional.one_hot(state, 16).to(dtype)
    results = []
    for kernel in map(surrogate.surrogate_many, (False, True)):
        monkeypatch.setattr(surrogate, "surrogate_kernel", lambda *_, kernel=kernel: kernel)
        results.append(value_and_gradient(linear_softmax_surrogate, *given))
    for dense, passed_over in zip(*results, strict=True):
        assert dense.abs().min() > 0
        assert torch.equal(dense, passed_over)


def test_the_choice_of_the_kernel():
    one_hot, dense = torch.eye(16).numpy(), torch.ones(3, 16).numpy()
    assert surrogate.surrogate_kernel((5, 4, 16), one_hot) is surrogate.surrogate_many(True)
    assert surrogate.surrogate_kernel((5, 4, 16), dense) is surrogate.surrogate_many(False)
    assert surrogate.surrogate_kernel((5, 4, 4), one_hot[:, :4]) is surrogate.surrogate_many(False)
    assert surrogate.surrogate_kernel((5, 4, 16), dense[:0]) is surrogate.surrogate_many(False)


@pytest.mark.parametrize(("action", "trial"), [(-1, 0), (3, 0), (0, -1), (0, 4)])
def test_out_of_range_beside_zeros(action, trial):
    observation, actions = torch.eye(16), torch.zeros(16, dtype=torch.int64)
    trials = torch.arange(16) // 4
    actions[7], trials[7] = action, trial
    with pytest.raises(IndexError, match="action"):
        linear_softmax_surrogate(observation, torch.ones(4, 3, 16), actions, torch.ones(16), trials)


def test_no_frames():
    value, gradient = value_and_gradient(linear_softmax_surrogate, *(problem(frames=0)))
    assert value.tolist() == [0] * 4
    assert not gradient.any()


# As in test_linear.py, parts of larger arrays: code that reads behind them fails the test only.


@pytest.mark.parametrize("n_actions", [2, 3])
@pytest.mark.parametrize("entry", [0, 2, 3, 4])
def test_shapes_that_do_not_fit(n_actions, entry):
    given = list(problem(frames=6, n_actions=n_actions))
    given[entry] = given[entry][:-1]
    with pytest.raises((ValueError, RuntimeError, IndexError)):
        linear_softmax_surrogate(*given)


@pytest.mark.parametrize("n_actions", [2, 3])
@pytest.mark.parametrize("n_features", [4, 6])
def test_features_that_do_not_fit(n_actions, n_features):
    given = list(problem(frames=6, n_actions=n_actions))
    given[0] = torch.ones(9, n_features, dtype=torch.float64)[:6]
    with pytest.raises((ValueError, RuntimeError, IndexError)):
        linear_softmax_surrogate(*given)


@pytest.mark.parametrize("n_actions", [2, 3])
@pytest.mark.parametrize("n_features", [1, 4, 7, 17])
def test_sums_of_many_frames_are_those_in_double(n_actions, n_features):
    """Trials of all lengths about those of the blocks, each to a few units in the last place."""
    lengths = [1, 2, 7, 8, 9, 255, 256, 257, 264, 600, 1500]
    given = problem(sum(lengths), len(lengths), n_actions, n_features, torch.float32)
    given = [given[0], 0.3 * given[1], given[2], 20 + 5 * given[3]]
    trial = torch.repeat_interleave(torch.arange(len(lengths)), torch.tensor(lengths))
    value, gradient = value_and_gradient(linear_softmax_surrogate, *given, trial)
    exact = [x.double() if x.is_floating_point() else x for x in given]
    logits = (exact[1][trial] @ exact[0].unsqueeze(-1)).squeeze(-1)
    log_prob = logits.log_softmax(-1).gather(1, exact[2].unsqueeze(1)).squeeze(1)
    total = lane_sum(log_prob * exact[3], trial, len(lengths))
    torch.testing.assert_close(value.double(), total, rtol=1e-6, atol=0)
    share = torch.nn.functional.one_hot(exact[2], n_actions) - logits.softmax(-1)
    terms = (share * exact[3].unsqueeze(-1)).unsqueeze(-1) * exact[0].unsqueeze(1)
    for k in range(len(lengths)):
        rows = trial == k
        error = (gradient[k].double() / (k + 1) - terms[rows].sum(0)).abs()
        assert (error <= 1e-6 * terms[rows].abs().sum(0)).all()


@pytest.mark.parametrize("n_actions", [2, 3])
def test_value_and_gradient_are_multiplied_by_a_scale(n_actions):
    columns = problem(n_actions=n_actions)
    total, gradient = linear_softmax_gradient(*columns)
    halved, half = linear_softmax_gradient(*columns, 0.5)
    assert torch.equal(halved, 0.5 * total)
    assert torch.equal(half, 0.5 * gradient)
