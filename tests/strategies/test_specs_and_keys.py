"""Specs, masks, heads, groups of agents, and the ends of number types."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Categorical, Composite, MultiCategorical, MultiOneHot, OneHot

from tests.strategies.samples import data
from trl_explore.strategies import (
    Argmax,
    CountBonus,
    EpsilonGreedy,
    EpsilonSoftmax,
    Random,
    Softmax,
)

# Specs, masks and numbers


@pytest.mark.parametrize("spec", [OneHot(3), Categorical(3)], ids=["one_hot", "categorical"])
def test_a_mask_in_the_spec_is_obeyed(spec):
    strategy = EpsilonGreedy(0.9, spec=Composite(action=spec))
    frames = data(300, logits=torch.tensor([5.0, 1.0, 0.0]).expand(300, 3))
    for legal in ([False, True, True], [True, False, False]):
        spec.update_mask(torch.tensor(legal))
        action = strategy(frames)["action"]
        index = action.int().argmax(-1) if isinstance(spec, OneHot) else action
        assert index.unique().tolist() == torch.tensor(legal).nonzero().flatten().tolist()


@pytest.mark.parametrize("spec", [MultiOneHot([3, 2]), MultiCategorical([3, 2])])
def test_every_head_draws_its_own_action(spec):
    logits = torch.tensor([0.0, 1.0, 2.0, 1.0, 0.0]).expand(20_000, 5)
    strategy = Softmax(spec=spec)
    out = strategy(TensorDict({"logits": logits}, [20_000]))
    assert spec.expand(20_000, *spec.shape).is_in(out["action"])
    heads = out["action"]
    if isinstance(spec, MultiOneHot):
        heads = torch.stack([part.int().argmax(-1) for part in heads.split([3, 2], -1)], -1)
    parts = [part.softmax(-1) for part in logits.split([3, 2], -1)]
    log_probs = [p.gather(-1, heads[:, i : i + 1]).log() for i, p in enumerate(parts)]
    torch.testing.assert_close(out["action_log_prob"], torch.cat(log_probs, -1).sum(-1))
    shares = torch.bincount(heads[:, 0] * 2 + heads[:, 1], minlength=6) / 20_000
    joint = (parts[0][0].unsqueeze(1) * parts[1][0]).flatten()
    torch.testing.assert_close(shares, joint, atol=0.015, rtol=0)
    with strategies_off():
        greedy = strategy(TensorDict({"logits": logits[:1]}, [1]))["action"]
    expected = [[0, 0, 1, 1, 0]] if isinstance(spec, MultiOneHot) else [[2, 0]]
    assert greedy.int().tolist() == expected


def strategies_off():
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    return set_exploration_type(ExplorationType.DETERMINISTIC)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_low_precision_and_many_actions(dtype):
    n = 70_000  # more than the largest float16
    logits = torch.zeros(200, n, dtype=dtype)
    logits[:, 3] = 1
    out = EpsilonGreedy(0.5)(TensorDict({"logits": logits}, [200]))
    assert 60 < int((out["action"] == 3).sum()) < 140
    expected = torch.where(out["action"] == 3, 0.5 + 0.5 / n, 0.5 / n).log()
    torch.testing.assert_close(out["action_log_prob"], expected)


def test_logits_at_the_ends_of_their_type():
    logits = torch.tensor([[3e38, -3e38, 3e38], [-3e38, -torch.inf, -3e38]])
    for strategy in (Argmax(), Softmax(1e-30), EpsilonSoftmax(0.0)):
        out = strategy(TensorDict({"logits": logits.repeat(50, 1)}, [100]))
        assert set(out["action"].tolist()) == {0, 2}
        torch.testing.assert_close(out["action_log_prob"].exp(), torch.full((100,), 0.5))


@pytest.mark.parametrize("strategy", [Argmax, EpsilonGreedy, Softmax, Random])
def test_a_state_without_an_action_is_an_error_unless_it_is_not_checked(strategy):
    entries = {"logits": torch.tensor([[-torch.inf, 1.0]])}
    frames = TensorDict({**entries, "action_mask": torch.tensor([[True, False]])}, [1])
    with pytest.raises(ValueError, match="finite logit"):
        strategy()(frames)
    assert strategy(validate_args=False)(frames)["action_log_prob"].isnan().all()


# Keys


def test_an_observation_called_noise_or_trial_is_not_taken_for_ours():
    entries = {"noise": torch.zeros(400, 2), "trial": torch.full((400,), -7.0)}
    for strategy in (Random(), EpsilonGreedy(1.0), CountBonus()):
        actions = strategy(data(400, logits=torch.zeros(400, 3), **entries))["action"]
        assert len(actions.unique()) == 3


def test_groups_of_agents_do_not_share_an_entry():
    groups = {"left": OneHot(3), "right": Categorical(5)}
    sizes = {"left": (2, 3), "right": (4, 5)}
    frames = TensorDict(
        {
            group: TensorDict(
                {
                    "logits": torch.randn(6, *size),
                    "action_mask": torch.ones(6, *size, dtype=torch.bool).tril(),
                },
                [6, size[0]],
            )
            for group, size in sizes.items()
        },
        [6],
    )
    spec = Composite(
        {group: Composite(action=leaf.expand(sizes[group][0], *leaf.shape), shape=sizes[group][:1])
         for group, leaf in groups.items()}
    )  # fmt: skip
    for group in groups:
        action, logits = (group, "action"), (group, "logits")
        EpsilonGreedy(0.5, spec=spec, logits_key=logits, action_key=action)(frames)
    for group, size in sizes.items():
        assert frames[group, "action_log_prob"].shape == (6, size[0])
        assert (
            spec[group, "action"]
            .expand(6, *spec[group, "action"].shape)
            .is_in(frames[group, "action"])
        )
    index = frames["left", "action"].int().argmax(-1)
    assert (index <= torch.arange(2)).all()  # the mask of the group is obeyed
    assert "action_log_prob" not in frames
    with pytest.raises(ValueError, match=r"action_key.*'left', 'action'"):
        EpsilonGreedy(spec=spec)


def test_values_per_trial_in_a_group():
    strategy = EpsilonGreedy([0.0, 1.0], logits_key=("agents", "logits"), trial_key="run")
    logits = torch.tensor([1.0, 0.0, 0.0]).expand(200, 5, 3)
    frames = TensorDict({"agents": {"logits": logits}, "run": torch.arange(200) % 2}, [200])
    actions = strategy(frames)["action"]
    assert (actions[::2] == 0).all()
    assert 0.5 < (actions[1::2] > 0).float().mean() < 0.8
