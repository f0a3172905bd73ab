"""The actions that every discrete strategy draws, and their log-probabilities."""

from itertools import product

import numpy as np
import pytest
import torch
from scipy import stats
from tensordict import TensorDict
from torchrl.data import Categorical, Composite, OneHot
from torchrl.envs.utils import ExplorationType, set_exploration_type

from tests.strategies.from_files import (
    BATCHES,
    FILES,
    NEVER,
    assert_log_prob,
    build,
    frames,
    logits_of,
    mu,
    uniforms,
)
from trl_explore.strategies import Strategy
from trl_explore.training.evaluation import acting

pytestmark = pytest.mark.parametrize("name", FILES)


ARGMAX = [ExplorationType.MODE, ExplorationType.MEAN, ExplorationType.DETERMINISTIC]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_log_prob_is_that_of_the_drawn_action(name, dtype):
    strategy = build(name, iteration=60)
    data = strategy(frames(logits_of(300).to(dtype)))
    assert_log_prob(strategy, data, mu(strategy, data))
    if strategy.exact:
        assert data["action_log_prob"].dtype == dtype
        assert data["action_log_prob"].shape == (300,)


@pytest.mark.parametrize("iteration", [0, 60])
@pytest.mark.parametrize("mode", [ExplorationType.RANDOM, None])
def test_frequencies_are_the_probabilities(name, iteration, mode):
    torch.manual_seed(3)
    strategy = build(name, iteration=iteration)
    logits = torch.tensor([0.0, 1.0, NEVER, 0.8, 1.0], dtype=torch.float64)
    with set_exploration_type(mode):
        data = strategy(frames(logits.expand(20_000, 5)))
    counts = np.bincount(data["action"].numpy(), minlength=5)
    expected = 20_000 * mu(strategy, data)[0].numpy()
    possible = expected > 0
    assert counts[~possible].sum() == 0
    if possible.sum() > 1:
        assert stats.chisquare(counts[possible], expected[possible]).pvalue > 1e-3


def test_a_strategy_explores_unless_told_otherwise(name):
    actions = build(name)(frames(torch.zeros(400, 4)))["action"]
    assert len(actions.unique()) == 4


@pytest.mark.parametrize("mode", ARGMAX, ids=str)
def test_exploration_off_takes_the_argmax(name, mode):
    logits = torch.cat(
        [logits_of(100), torch.tensor([[1.0, 3.0, 2.0, 3.0], [NEVER, 0.0, 0.0, -1.0]])]
    )
    strategy = build(name)
    with set_exploration_type(mode):
        data = strategy(frames(logits, noise=uniforms(strategy, 102)))
        assert torch.equal(data["action"], torch.from_numpy(logits.numpy().argmax(-1)))
        if strategy.exact:
            assert data["action_log_prob"].tolist() == [0.0] * 102
        mask = torch.ones(102, 4, dtype=torch.bool)
        mask[:, 1] = False
        masked = strategy(frames(logits, action_mask=mask))["action"]
        assert torch.equal(masked, logits[:, [0, 2, 3]].argmax(-1).apply_(lambda k: (0, 2, 3)[k]))


def test_who_exploits_reads_and_writes_the_same_entries(name):
    keys = {"logits_key": "value", "action_key": "move", "action_mask_key": "legal"}
    greedy = acting(build(name, spec=OneHot(4), **keys), "greedy")
    legal = torch.tensor([[False, True, True, True]])
    data = TensorDict({"value": torch.tensor([[5.0, 0, 3, 1]]), "legal": legal}, [1])
    assert greedy(data)["move"].tolist() == [[False, False, True, False]]


def test_exploration_off_draws_no_numbers(name):
    before = torch.get_rng_state()
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        build(name)(frames(torch.zeros(50, 4)))
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("iteration", [0, 60])
def test_noise_decides_the_draw(name, iteration):
    logits = torch.cat([logits_of(300), torch.zeros(300, 4)])
    strategies = [build(name, iteration=iteration) for _ in range(2)]
    noise = uniforms(strategies[0], 600)
    a, b = (strategy(frames(logits, noise=noise))["action"] for strategy in strategies)
    assert torch.equal(a, b)
    if type(strategies[0]).explore is not Strategy.explore:
        return  # it uses the noise in a way of its own
    cdf = mu(strategies[0], frames(logits)).double().numpy().cumsum(-1)
    for row in range(600):
        at = noise[row].item() * cdf[row, -1]
        assert a[row] == np.searchsorted(cdf[row], at, side="right")


def test_batch_shapes(name):
    strategy = build(name)
    for batch, given in product(BATCHES, (True, False)):
        entries = {"noise": uniforms(strategy, *batch)} if given else {}
        data = strategy(frames(logits_of(*batch), **entries))
        assert data["action"].shape == batch
        assert data["action"].dtype == torch.int64
        if strategy.exact:
            assert data["action_log_prob"].shape == batch


@pytest.mark.parametrize("composite", [False, True])
def test_one_hot_and_categorical_actions_are_the_same(name, composite):
    actions = {}
    for spec in (Categorical(4), OneHot(4)):
        strategy = build(name, spec=Composite(action=spec) if composite else spec)
        data = strategy(frames(logits_of(100), noise=uniforms(strategy, 100)))
        actions[type(spec)] = data["action"]
        assert data["action"].dtype == spec.dtype
        assert spec.expand(*data.batch_size, *spec.shape).is_in(data["action"])
        if strategy.exact:
            assert data["action_log_prob"].shape == (100,)
    assert torch.equal(actions[OneHot].int().argmax(-1), actions[Categorical])
    assert (actions[OneHot].sum(-1) == 1).all()
