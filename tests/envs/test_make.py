"""Any gymnasium environment as a TorchRL environment: its episodes are gymnasium's."""

from __future__ import annotations

from typing import Any, cast

import gymnasium as gym
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase
from torchrl.envs.utils import check_env_specs
from torchrl.modules import RandomPolicy

from trl_explore.envs import lane_env, make_env
from trl_explore.numerics.streams import Stream, generator
from trl_explore.strategies import Softmax

IDS = {  # id -> number of features, number of actions
    "CartPole-v1": (4, 2),
    "Acrobot-v1": (6, 3),
    "MountainCar-v0": (2, 3),
    "FrozenLake-v1": (16, 4),
    "CliffWalking-v1": (48, 4),
    "Taxi-v4": (500, 6),
}


DISCRETE = ("FrozenLake-v1", "CliffWalking-v1", "Taxi-v4")


def reference(id: str, trial: int, episode: int, seed: int = 0, **kwargs) -> tuple[gym.Env, ...]:
    """gymnasium's own environment at the start of an episode, and its first observation."""
    env = gym.make(id, **kwargs)
    if id in DISCRETE:
        env = gym.wrappers.FlattenObservation(env)
    env.unwrapped.np_random = generator(seed, Stream.ENVIRONMENT, trial, episode)
    return env, env.reset()[0]


def restart(env: EnvBase, mask: list[bool]) -> torch.Tensor:
    """Reset the lanes of the mask; the observations of all [trials, n_features]."""
    mask = torch.tensor(mask)
    reset = TensorDict({"_reset": mask.unsqueeze(-1)}, mask.shape)
    return env.reset(reset)["observation"]


@pytest.mark.parametrize("id", IDS)
def test_specs(id):
    n_features, n_actions = IDS[id]
    env = make_env(id, trials=3, max_steps=30)
    check_env_specs(env, break_when_any_done="both")
    assert env.batch_size == (3,)
    assert env.action_spec.space.n == n_actions
    observation = env.reset()["observation"]
    assert observation.shape == (3, n_features)
    assert env.observation_spec["observation"].shape == (3, n_features)


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("first_trial", [0, 7])
def test_every_transition_is_gymnasiums(id, first_trial):
    """Reward, flags and observations of two episodes, with lanes that finish at other times."""
    trials, limit = 3, 25
    env = make_env(id, trials, max_steps=limit, seed=11, first_trial=first_trial)
    actions = np.random.default_rng(3).integers(IDS[id][1], size=(2, limit, trials))
    for episode in range(2):
        td = env.reset()
        others = [
            reference(id, first_trial + k, episode, seed=11, max_episode_steps=limit)
            for k in range(trials)
        ]
        for k, (_, observation) in enumerate(others):
            np.testing.assert_array_equal(td["observation"][k].numpy(), observation)
        done, score = [False] * trials, np.zeros(trials)
        for step in range(limit):
            td["action"] = torch.from_numpy(actions[episode, step])
            td = env.step(td)
            after = td["next"]
            for k, (other, _) in enumerate(others):
                if done[k]:
                    continue
                expected, reward, terminated, truncated, _ = other.step(actions[episode, step, k])
                score[k] += reward
                done[k] = terminated or truncated
                np.testing.assert_array_equal(after["observation"][k].numpy(), expected)
                assert after["reward"][k].item() == reward
                assert after["terminated"][k].item() == terminated
                assert after["truncated"][k].item() == truncated
                assert after["done"][k].item() == done[k]
                assert after["step_count"][k].item() == step + 1
                assert after["episode_reward"][k].item() == score[k]
            td = env._step_mdp(td)
        assert all(done)


def test_an_episode_depends_on_its_number_and_nothing_else():
    env = make_env(trials=3, seed=4)
    first = env.reset()["observation"].clone()
    second = env.reset()["observation"].clone()
    assert (first != second).any(-1).all()
    lane_env(env).reseed(4)
    for _ in range(5):  # lane 1 alone; the others keep their places
        restart(env, [False, True, False])
    assert torch.equal(restart(env, [True, False, False])[0], first[0])
    assert torch.equal(restart(env, [True, False, True])[0], second[0])
    expected = reference("CartPole-v1", 1, 5, seed=4)[1]
    np.testing.assert_array_equal(restart(env, [False, True, False])[1].numpy(), expected)


def test_each_lane_of_each_seed_has_its_own_stream():
    starts = [
        tuple(row)
        for seed in range(4)
        for row in make_env(trials=6, seed=seed).reset()["observation"].tolist()
    ]
    assert len(set(starts)) == len(starts)


def test_lane_k_is_first_trial_k():
    together = make_env(trials=5, seed=2).reset()["observation"]
    for k in range(5):
        alone = make_env(trials=1, seed=2, first_trial=k).reset()["observation"]
        assert torch.equal(alone[0], together[k])


def test_frozen_lake_draws_at_every_step_from_its_own_stream():
    """The lanes slip independently although they take the same actions."""
    env = make_env("FrozenLake-v1", trials=20)
    places = env.rollout(6, RandomPolicy(env.action_spec), break_when_any_done=False)
    assert len(places["next", "observation"][:, -1].unique(dim=0)) > 1


def test_the_pole_that_falls_is_terminated():
    env = make_env(trials=1)
    data = env.rollout(50, lambda td: td.set("action", torch.tensor([1])))
    last = data[0, -1]["next"]
    assert last["terminated"].item()
    assert not last["truncated"].item()
    assert abs(last["observation"][2]) > 12 * np.pi / 180


@pytest.mark.parametrize("id", ["Acrobot-v1", "MountainCar-v0", *DISCRETE])
def test_agents_train_on_it(id, train):
    before = train(Softmax(), id=id, max_steps=15, max_iterations=1)
    after = train(Softmax(), id=id, max_steps=15, max_iterations=3, score_threshold=1e9)
    assert after.trials.status.tolist() == ["capped", "capped"]
    weights = [job.optimizer.parameters[0] for job in (before, after)]
    assert weights[0].shape == (2, IDS[id][1], IDS[id][0])
    assert weights[1].isfinite().all()


def test_actions_outside_of_the_bounds_are_clipped_for_the_environment_only():
    """gymnasium's car charges for the force that is asked for, so that it must not see −7."""
    id = "MountainCarContinuous-v0"  # forces within [-1, 1]
    env = make_env(id, trials=3, seed=5)
    td = env.reset()
    assert env.action_spec.shape == (3, 1)
    drawn = torch.tensor([[-7.0], [0.5], [1.5]])
    td = env.step(td.set("action", drawn))
    assert torch.equal(td["action"], drawn)
    rewards = td["next", "reward"].flatten().tolist()
    assert rewards == pytest.approx([-0.1, -0.025, -0.1])
    for k, seen in enumerate([-1.0, 0.5, 1.0]):
        other, _ = reference(id, k, 0, seed=5)
        expected, *_ = other.step(np.array([seen], np.float32))
        np.testing.assert_array_equal(td["next", "observation"][k].numpy(), expected)


def test_specs_of_continuous_actions():
    check_env_specs(make_env("Pendulum-v1", trials=3, max_steps=5), break_when_any_done="both")


def test_lane_env_refuses_other_environments():
    with pytest.raises(ValueError, match=r"lanes.*trl_explore\.envs\.make_env"):
        lane_env(cast(Any, object()))
