"""μ of every strategy over discrete actions: a distribution, also under a mask."""

from itertools import product

import pytest
import torch

from tests.strategies.from_files import (
    BATCHES,
    FILES,
    NEVER,
    assert_log_prob,
    build,
    drawn,
    frames,
    logits_of,
    mu,
)

pytestmark = pytest.mark.parametrize("name", FILES)


@pytest.mark.parametrize("iteration", [0, 60])
def test_probs_are_a_distribution(name, iteration):
    strategy = build(name, iteration=iteration)
    for batch, n in product(BATCHES, (1, 2, 9)):
        logits = logits_of(*batch, n=n)
        before = logits.clone()
        probs = strategy.probs(logits)
        assert probs.shape == logits.shape
        assert probs.dtype == logits.dtype
        assert (probs >= 0).all()
        torch.testing.assert_close(probs.sum(-1), torch.ones(batch))
        assert torch.equal(logits, before)


@pytest.mark.parametrize("iteration", [0, 60])
def test_a_logit_of_minus_infinity_gets_nothing(name, iteration):
    logits = torch.tensor(
        [[NEVER, 1.0, 2.0, 2.0], [0.5, NEVER, NEVER, 1.0], [NEVER, NEVER, 0, NEVER]]
    )
    strategy = build(name, iteration=iteration)
    probs = strategy.probs(logits)
    assert (probs[logits == NEVER] == 0).all()
    torch.testing.assert_close(probs.sum(-1), torch.ones(3))
    # What is forbidden might as well not be there.
    torch.testing.assert_close(probs[1, [0, 3]], strategy.probs(logits[1, [0, 3]]))
    assert probs[2].tolist() == [0, 0, 1, 0]


def test_frames_do_not_depend_on_each_other(name):
    strategy = build(name, iteration=60)
    logits = logits_of(6)
    together = strategy.probs(logits)
    for row in range(6):
        assert torch.equal(strategy.probs(logits[row]), together[row])


def test_equal_preferences_are_equally_likely(name):
    probs = build(name, iteration=60).probs(torch.tensor([1.0, 3.0, 1.0, 3.0]))
    assert probs[0] == probs[2]
    assert probs[1] == probs[3]
    assert probs[1] >= probs[0]


@pytest.mark.parametrize("iteration", [0, 60])
def test_mask_is_obeyed(name, iteration):
    generator = torch.Generator().manual_seed(5)
    logits = logits_of(500)
    mask = torch.rand(500, 4, generator=generator) < 0.4
    mask[torch.arange(500), torch.randint(4, (500,), generator=generator)] = True
    strategy = build(name, iteration=iteration)
    data = strategy(frames(logits, action_mask=mask))
    assert mask.gather(-1, data["action"].unsqueeze(-1)).all()
    probs = mu(strategy, data)
    assert (probs[~mask] == 0).all()
    assert_log_prob(strategy, data, probs)
    assert torch.equal(data["logits"], logits)
    assert torch.equal(data["logits"], logits_of(500))


def test_mask_that_allows_everything_changes_nothing(name):
    logits, mask = logits_of(100), torch.ones(100, 4, dtype=torch.bool)
    plain = drawn(build(name), frames(logits))
    masked = drawn(build(name), frames(logits, action_mask=mask))
    assert torch.equal(plain["action"], masked["action"])
    if build(name).exact:
        assert torch.equal(plain["action_log_prob"], masked["action_log_prob"])


def test_mask_that_forbids_everything_is_an_error(name):
    mask = torch.tensor([[True, False, False, False], [False] * 4])
    with pytest.raises(ValueError, match="action mask"):
        build(name)(frames(logits_of(2), action_mask=mask))
