"""Where episodes end, whose frames they are, and what is padding."""

import math

import pytest
import torch
from tensordict import TensorDict

from tests.objectives.episodes import (
    KINDS,
    episode,
    random_episodes,
    tabular,
)
from trl_explore.envs import make_env
from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.episodes import Episodes
from trl_explore.policies import LinearPolicy
from trl_explore.policies.actor import SoftmaxActor

# Where an episode ends


def test_truncated_and_terminated_are_treated_alike(env):
    loss = ReinforceLoss(tabular("torch", env)[0])
    terminated = torch.cat([episode([1, 0, 1], [1.0, 2.0, 3.0]), episode([1], [4.0])])
    truncated = terminated.clone()
    truncated["next", "truncated"] = terminated["next", "terminated"].clone()
    truncated["next", "terminated"] = torch.zeros(4, 1, dtype=torch.bool)
    assert loss.advantage(truncated)[2:].tolist() == [3.0, 4.0]
    assert torch.equal(loss(terminated)["loss_actor"], loss(truncated)["loss_actor"])


@pytest.mark.parametrize("kind", KINDS)
def test_trial_boundaries_without_done(kind, env):
    loss = ReinforceLoss(tabular(kind, env)[0], gamma=0.5, trials=30)
    done, cut = (
        torch.cat(
            [
                episode([1, 0], [1.0, 2.0], trial=4, done=end),
                episode([0], [4.0], trial=2, done=end),
                episode([1, 1], [8.0, 16.0], trial=7, done=end),
            ]
        )
        for end in (True, False)
    )
    assert loss.advantage(cut).tolist() == [2.0, 2.0, 4.0, 16.0, 16.0]
    assert torch.equal(loss(cut)["trial_loss"], loss(done)["trial_loss"])
    assert not cut["next", "done"].any()


def test_several_episodes_of_a_trial(env):
    loss = ReinforceLoss(tabular("linear", env)[0], gamma=0.5, trials=30, weight=1.0)
    data = torch.cat([episode([1, 1], [1.0, 2.0], trial=3), episode([1], [4.0], trial=3)])
    assert loss.advantage(data).tolist() == [2.0, 2.0, 4.0]
    out = loss(data)["trial_loss"]
    assert out[3].item() == pytest.approx(-8 * math.log(0.75), rel=1e-6)
    assert out.count_nonzero() == 1


def test_without_trial_all_flat_frames_are_one_trials(env):
    loss = ReinforceLoss(tabular("torch", env)[0], gamma=0.5)
    data = torch.cat([episode([1, 1], [1.0, 2.0]), episode([1], [4.0])])
    expected = loss(data)["loss_actor"]
    out = loss(data.exclude("trial"))
    assert out["trial_loss"].shape == (1,)
    torch.testing.assert_close(out["loss_actor"], expected)


# Trials


@pytest.mark.parametrize("masked", [False, True])
def test_other_lanes_change_nothing(masked, env):
    # `masked` is the way through the distribution; the plain policy has a shorter one.
    g = torch.Generator().manual_seed(0)
    lengths = torch.randint(1, 80, (30,), generator=g).tolist()
    data = random_episodes(lengths)
    data["action_mask"] = torch.ones(len(data), 2, dtype=torch.bool)

    def run(data, trials, first_trial):
        small = env if trials == 30 else make_env("CartPole-v1", trials=trials)
        policy = LinearPolicy(small, seed=1, first_trial=first_trial)
        loss = ReinforceLoss(SoftmaxActor(policy, masked=masked), trials=trials)
        out = loss(data)
        out["loss_actor"].backward()
        return out["trial_loss"], policy.weight.grad

    together, gradient = run(data, 30, 0)
    for k in (0, 7, 29):
        alone = data[data["trial"] == k].clone()
        alone["trial"] = torch.zeros_like(alone["trial"])
        own, own_gradient = run(alone, 1, k)
        assert torch.equal(own[0], together[k])
        assert torch.equal(own_gradient[0], gradient[k])


@pytest.mark.parametrize("kind", KINDS)
def test_a_trial_without_frames_has_no_loss_and_no_gradient(kind, env):
    actor, weight = tabular(kind, env)
    loss = ReinforceLoss(actor, trials=30)
    data = torch.cat([episode([1, 0], [1.0, 2.0], trial=3), episode([0], [4.0], trial=11)])
    out = loss(data)
    assert out["trial_loss"].nonzero().flatten().tolist() == [3, 11]
    out["loss_actor"].backward()
    if kind == "linear":
        assert weight.grad.flatten(1).abs().sum(-1).nonzero().flatten().tolist() == [3, 11]


def test_number_of_trials_is_that_of_the_data(env):
    loss = ReinforceLoss(tabular("torch", env)[0])
    data = torch.cat([episode([1], [1.0], trial=3), episode([0], [4.0], trial=1)])
    assert loss(data)["trial_loss"].shape == (4,)


def test_a_trial_out_of_range_is_an_error(env):
    for kind in KINDS:
        loss = ReinforceLoss(tabular(kind, env)[0], trials=30)
        with pytest.raises((IndexError, RuntimeError)):
            loss(episode([1, 0], [1.0, 1.0], trial=30))


# [batch, time] and padding


def padded(lengths, time, *, trailing, with_trial, seed=0, dtype=torch.float32):
    """Rows of episodes with rubbish behind them, and the same episodes flat."""
    flat = random_episodes(lengths, seed=seed, dtype=dtype)
    rows, mask = [], torch.zeros(len(lengths), time, dtype=torch.bool)
    for row, (part, length) in enumerate(zip(flat.split(lengths), lengths, strict=True)):
        rubbish = random_episodes([time], [row], seed=99, dtype=dtype)[: time - length]
        rubbish["observation"][:] = torch.nan
        rubbish["next", "reward"][:] = torch.nan
        rows.append(torch.cat([part, rubbish]))
        mask[row, :length] = True
    data = torch.stack(rows).contiguous()
    data["collector", "mask"] = mask.unsqueeze(-1) if trailing else mask
    return flat, data if with_trial else data.exclude("trial")


@pytest.mark.parametrize("done", [True, False])
@pytest.mark.parametrize("with_trial", [True, False])
@pytest.mark.parametrize("trailing", [True, False])
def test_padding_changes_nothing(trailing, with_trial, done, env):
    actor, weight = tabular("torch", env)
    loss = ReinforceLoss(actor, gamma=0.9, baseline=0.3)
    results = []
    flat, rows = padded([5, 1, 8], 8, trailing=trailing, with_trial=with_trial)
    if not done:
        flat["next", "done"][:] = False
        rows["next", "done"][:] = False
    for data in (flat, rows):
        out = loss(data)
        results.append((out["trial_loss"], torch.autograd.grad(out["loss_actor"], weight)[0]))
    assert results[0][0].shape == (3,)
    torch.testing.assert_close(results[1], results[0])


@pytest.mark.parametrize("masked", [False, True])
def test_padding_changes_nothing_for_the_linear_policy(masked, env):
    policy = LinearPolicy(env, seed=4)
    loss = ReinforceLoss(SoftmaxActor(policy, masked=masked), trials=30)
    flat, rows = padded([5, 1, 8], 8, trailing=False, with_trial=True)
    results = []
    for data in (flat, rows):
        data["action_mask"] = torch.ones(*data.shape, 2, dtype=torch.bool)
        out = loss(data)
        results.append(
            (out["trial_loss"], torch.autograd.grad(out["loss_actor"], policy.weight)[0])
        )
    assert torch.isfinite(results[0][1]).all()
    torch.testing.assert_close(results[1], results[0])


def test_padding_of_flat_frames(env):
    loss = ReinforceLoss(tabular("torch", env)[0], gamma=0.5)
    data = torch.cat([episode([1, 1], [1.0, 2.0], done=False), episode([1, 0], [4.0, 8.0])])
    data["collector", "mask"] = torch.tensor([True, True, False, True])
    kept = data[[0, 1, 3]].exclude("collector").clone()
    kept["next", "done"][1] = True  # the next valid frame does not belong to it
    assert torch.equal(loss(data)["loss_actor"], loss(kept)["loss_actor"])


def test_a_frame_counts_where_every_mask_of_torchrl_says_so(env):
    loss = ReinforceLoss(tabular("torch", env)[0], gamma=0.5, weight=1.0)
    data = torch.cat([episode([1], [2.0**k]) for k in range(4)])
    data["collector", "mask"] = torch.tensor([True, True, False, False])
    data["shifted_valid"] = torch.tensor([True, False, True, False])
    assert loss(data)["loss_actor"].item() == pytest.approx(-math.log(0.75), rel=1e-6)


def test_rows_of_a_batch_are_trials(env):
    loss = ReinforceLoss(tabular("torch", env)[0], gamma=0.5, weight=1.0)
    first, second = episode([1, 1], [1.0, 2.0], done=False), episode([0, 1], [4.0, 8.0])
    out = loss(torch.stack([first, second]).exclude("trial"))["trial_loss"]
    expected = [-(2 + 2) * math.log(0.75), -8 * math.log(0.25) - 8 * math.log(0.75)]
    torch.testing.assert_close(out, torch.tensor(expected))


def test_an_episode_that_was_cut_off_ends_with_its_last_frame():
    """Because another trial follows, or no frame at all."""
    done, trial = torch.tensor([0, 1, 0, 0, 0]).bool(), torch.tensor([0, 0, 0, 1, 1])
    episodes = Episodes(TensorDict({}, [5]), torch.ones(5), done, trial, 2, 1.0)
    assert episodes.ends.tolist() == [False, True, True, False, True]
    assert episodes.starts.tolist() == [True, False, True, True, False]
