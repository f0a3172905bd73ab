import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torchrl.data import (
    Binary,
    Bounded,
    Categorical,
    Composite,
    OneHot,
    Unbounded,
)

from trl_explore.strategies import (
    VDBE,
    CountBonus,
    EpsilonGreedy,
    EpsilonZGreedy,
    Gaussian,
    ParameterNoise,
    Softmax,
    Strategy,
    inverse_cdf,
)
from trl_explore.strategies.parameters import advance
from trl_explore.strategies.schedules import Linear

ALMOST_ONE = float(np.nextafter(1.0, 0.0))
MU = torch.tensor([0.25, 0.0, 0.5, 0.25])

weights = st.lists(st.floats(0, 1e3), min_size=1, max_size=8).filter(lambda w: sum(w) > 1e-3)
noise = st.floats(0, 1, exclude_max=True)


class Fixed(Strategy):
    """The same probabilities whatever the logits say, unless they forbid an action."""

    def probs(self, logits, trial=None):
        return torch.where(logits == -torch.inf, 0, MU.to(logits.dtype))


def frames(n, **entries):
    return TensorDict({"logits": torch.zeros(n, 4), **entries}, [n])


def test_what_a_strategy_does_is_declared_by_what_it_overrides():
    class Learner(Fixed):
        def step(self, data=None):
            super().step(data)

    class Preparer(Learner):
        learns_from_data = False

        def begin(self, active, episodes): ...

    kinds = Fixed, Learner, Preparer
    assert [kind.learns_from_data for kind in kinds] == [False, True, False]
    assert [kind.per_episode for kind in kinds] == [False, False, True]
    own = Softmax, VDBE, CountBonus, ParameterNoise
    assert [kind.learns_from_data for kind in own] == [False, True, True, True]
    assert [kind.per_episode for kind in own] == [False, False, False, True]
    assert [kind().compilable for kind in own] == [True, True, False, True]
    assert EpsilonZGreedy.per_episode


# The inverse of the distribution function


def test_inverse_cdf_by_hand():
    u = torch.tensor([0.0, 0.2499, 0.25, 0.5, 0.7499, 0.75, ALMOST_ONE], dtype=torch.float64)
    assert inverse_cdf(MU.expand(7, 4), u).tolist() == [0, 0, 2, 2, 2, 3, 3]


def test_inverse_cdf_at_the_edges_of_the_noise():
    for zeros in ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]):
        for u in (0.0, 0.5, ALMOST_ONE, 1.0):
            assert inverse_cdf(torch.tensor(zeros), torch.tensor(u)).item() == zeros.index(1.0)
    assert inverse_cdf(torch.tensor([0.5, 0.5]), torch.tensor(1.0)).item() == 1


def test_noise_may_have_any_strides():
    """torch warns of a search for values that are not contiguous."""
    noise = torch.rand(4, 50, dtype=torch.float64).t()
    data = TensorDict({"logits": torch.randn(50, 4, 3), "noise": noise}, [50, 4])
    plain = data.clone().set("noise", noise.contiguous())
    act = Softmax(noise_key="noise")
    assert torch.equal(act(data)["action"], act(plain)["action"])


def test_inverse_cdf_where_the_sum_is_not_one():
    # Ten times float32's 0.1 is more than 1, and a third of float32 three times is not 1.
    u = torch.tensor([0.0, 0.0999, 0.55, ALMOST_ONE], dtype=torch.float64)
    assert inverse_cdf(torch.full((4, 10), 0.1), u).tolist() == [0, 0, 5, 9]
    short = torch.tensor([1 / 3, 1 / 3, 1 / 3 - 1e-7, 0.0])
    assert inverse_cdf(short, torch.tensor(ALMOST_ONE, dtype=torch.float64)).item() == 2
    assert inverse_cdf(torch.tensor([2.0, 6.0]), torch.tensor([0.2, 0.3]).double()).tolist() == [
        0,
        1,
    ]


def test_inverse_cdf_does_not_lose_small_noise():
    # In float32 the sums 1 - 2^-24 and 1 would be one.
    probs = torch.tensor([1 - 2**-24, 2**-30], dtype=torch.float32)
    assert inverse_cdf(probs, torch.tensor(ALMOST_ONE, dtype=torch.float64)).item() == 1


@settings(deadline=None, derandomize=True)
@given(weights, noise)
def test_inverse_cdf_never_takes_an_action_of_probability_zero(p, u):
    probs = torch.tensor(p)
    for point in (u, 0.0, ALMOST_ONE, 1.0):
        action = inverse_cdf(probs, torch.tensor(point, dtype=torch.float64))
        assert 0 <= action < len(p)
        assert probs[action] > 0


@settings(deadline=None, derandomize=True)
@given(weights, noise, noise)
def test_inverse_cdf_is_monotone(p, u, v):
    low, high = sorted((u, v))
    actions = inverse_cdf(torch.tensor(p).expand(2, -1), torch.tensor([low, high]).double())
    assert actions[0] <= actions[1]


@settings(deadline=None, derandomize=True)
@given(weights, noise)
def test_inverse_cdf_agrees_with_searchsorted(p, u):
    probs = torch.tensor(p, dtype=torch.float64)
    cdf = np.cumsum(probs.numpy())
    at = u * cdf[-1]
    if np.abs(cdf - at).min() > 1e-9 * cdf[-1]:
        expected = np.searchsorted(cdf, at, side="right")
        assert inverse_cdf(probs, torch.tensor(u, dtype=torch.float64)).item() == expected


def test_share_of_the_noise_is_the_probability():
    u = (torch.arange(1000, dtype=torch.float64) + 0.5) / 1000
    actions = inverse_cdf(MU.expand(1000, 4), u)
    assert torch.bincount(actions, minlength=4).tolist() == [250, 0, 500, 250]


@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 3), (0,)])
def test_inverse_cdf_batch_shapes(batch):
    actions = inverse_cdf(MU.expand(*batch, 4), torch.full(batch, 0.6))
    assert actions.shape == batch
    assert actions.dtype == torch.int64
    assert (actions == 2).all()


# What every strategy shares


def test_forward_by_hand():
    u = torch.tensor([0.1, 0.3, 0.9])
    out = Fixed(noise_key="noise")(frames(3, noise=u))
    assert out["action"].tolist() == [0, 2, 3]
    torch.testing.assert_close(out["action_log_prob"].exp(), torch.tensor([0.25, 0.5, 0.25]))


def test_forward_returns_the_tensordict_it_was_given():
    data = frames(3)
    assert Fixed()(data) is data
    assert set(data.keys()) == {"logits", "action", "action_log_prob"}


def test_keys_can_be_renamed():
    strategy = Fixed(
        logits_key=("agents", "value"),
        action_key=("agents", "move"),
        action_mask_key="legal",
        noise_key="u",
    )
    assert strategy.in_keys == [("agents", "value")]
    assert strategy.out_keys == [("agents", "move"), ("agents", "move_log_prob")]
    data = TensorDict({"agents": {"value": torch.zeros(3, 4)}, "u": torch.full((3,), 0.3)}, [3])
    assert strategy(data)["agents", "move"].tolist() == [2, 2, 2]
    data["legal"] = torch.zeros(3, 4, dtype=torch.bool)
    with pytest.raises(ValueError, match="action mask"):
        strategy(data)


def test_one_state_without_a_legal_action_is_an_error():
    mask = torch.ones(3, 4, dtype=torch.bool)
    mask[1] = False
    with pytest.raises(ValueError, match="action mask"):
        Fixed()(frames(3, action_mask=mask))


def test_numbers_come_from_torchs_generator():
    def draw(seed):
        torch.manual_seed(seed)
        return Fixed()(frames(200))["action"]

    with torch.random.fork_rng():
        assert torch.equal(draw(1), draw(1))
        assert not torch.equal(draw(1), draw(2))


def test_draws_of_successive_calls_differ():
    strategy = Fixed()
    assert not torch.equal(strategy(frames(200))["action"], strategy(frames(200))["action"])


def test_given_noise_leaves_the_generator_alone():
    before = torch.get_rng_state()
    Fixed(noise_key="noise")(frames(5, noise=torch.zeros(5)))
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("dtype", [None, torch.bfloat16])
def test_advance_is_a_step_of_that_many_frames(dtype):
    strategy, other = (EpsilonGreedy(Linear(1.0, 0.0, iterations=4)) for _ in range(2))
    if dtype is not None:
        strategy.type(dtype)
    advance(strategy, 7)
    other.step(frames(7))
    assert (int(strategy.iteration), int(strategy.frames)) == (1, 7)
    assert strategy.epsilon.item() == other.epsilon.item() == 0.75


def test_iteration_counts_from_zero():
    strategy = Fixed()
    seen = []
    for _ in range(3):
        seen.append(int(strategy.iteration))
        strategy(frames(5))
        strategy.step()
    assert seen == [0, 1, 2]


@pytest.mark.parametrize(
    ("spec", "dtype"),
    [
        (None, torch.int64),
        (Categorical(4), torch.int64),
        (Categorical(4, dtype=torch.int32), torch.int32),
        (Composite(action=Categorical(4, dtype=torch.int32)), torch.int32),
        (Composite(action=Composite(move=Categorical(4, shape=(3,))), shape=(3,)), torch.int64),
    ],
)
def test_actions_are_indices(spec, dtype):
    nested = isinstance(spec, Composite) and isinstance(spec["action"], Composite)
    key = ("action", "move") if nested else "action"
    strategy = Fixed(spec=spec, action_key=key, noise_key="noise")
    out = strategy(frames(3, noise=torch.tensor([0.1, 0.3, 0.9])))
    assert out[key].tolist() == [0, 2, 3]
    assert out[key].dtype == dtype


@pytest.mark.parametrize("dtype", [torch.bool, torch.int64, torch.float32])
@pytest.mark.parametrize("wrap", [lambda spec: spec, lambda spec: Composite(action=spec)])
def test_actions_are_one_hot(dtype, wrap):
    spec = OneHot(4, dtype=dtype)
    strategy = Fixed(spec=wrap(spec), noise_key="noise")
    out = strategy(frames(3, noise=torch.tensor([0.1, 0.3, 0.9])))
    assert out["action"].dtype == dtype
    assert out["action"].int().tolist() == [[1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    assert all(spec.is_in(action) for action in out["action"])


@pytest.mark.parametrize(
    "spec",
    [
        Bounded(-1, 1, shape=(2,)),
        Unbounded(2),
        Binary(2),
        Composite(action=Bounded(-1, 1, shape=(2,))),
    ],
    ids=lambda spec: type(spec).__name__,
)
def test_specs_that_cannot_be_served(spec):
    with pytest.raises(ValueError, match=r"Categorical.*OneHot"):
        Fixed(spec=spec)


@pytest.mark.parametrize("dtype", [torch.bool, torch.int8, torch.uint8, torch.int64, torch.float32])
def test_a_mask_of_any_number_type_is_obeyed(dtype):
    mask = torch.tensor([[0, 1, 1]], dtype=dtype)
    data = TensorDict({"logits": torch.tensor([[2.0, 1.0, 0.0]]), "action_mask": mask}, [1])
    written = EpsilonGreedy(0.0)(data)
    assert written["action"].tolist() == [1]
    assert written["action_log_prob"].tolist() == [0.0]


def test_a_mask_of_another_shape_is_one_line():
    data = TensorDict({"logits": torch.zeros(2, 3), "action_mask": torch.ones(2, 4)}, [2])
    with pytest.raises(ValueError, match=r"action_mask.*\[2, 4\].*\[2, 3\]"):
        EpsilonGreedy(0.1)(data)


@pytest.mark.parametrize("spec", [Categorical(2), OneHot(2)], ids=["categorical", "one_hot"])
@pytest.mark.parametrize("n", [1, 3])
def test_logits_that_do_not_fit_the_spec_are_refused(spec, n):
    with pytest.raises(ValueError, match=rf"logits.*{n}.*2 actions"):
        EpsilonGreedy(0.1, spec=spec)(TensorDict({"logits": torch.zeros(5, n)}, [5]))


def test_a_missing_key_is_named_with_what_is_there():
    with pytest.raises(KeyError, match=r"logits.*action_value"):
        EpsilonGreedy(0.1)(TensorDict({"action_value": torch.zeros(3, 2)}, [3]))
    with pytest.raises(KeyError, match=r"scale.*loc"):
        Gaussian()(TensorDict({"loc": torch.zeros(3, 1)}, [3]))
