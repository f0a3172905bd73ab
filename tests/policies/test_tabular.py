import gymnasium as gym
import pytest
import torch
from tensordict import TensorDict

from trl_explore.envs import make_env
from trl_explore.policies import LinearPolicy, TabularPolicy, initial_weights


def test_it_begins_uniform_over_a_table_of_all_states():
    env = make_env("FrozenLake-v1", trials=3, kwargs={"map_name": "8x8"})
    policy = TabularPolicy(env)
    assert policy.weight.shape == (3, 4, 64)
    assert not policy.weight.any()
    assert isinstance(policy, LinearPolicy)


def test_a_table_is_looked_up():
    policy = TabularPolicy(make_env("FrozenLake-v1", trials=2), init="normal", seed=3)
    (expected,) = initial_weights([16, 4], 2, "normal", seed=3)
    state, trial = torch.tensor([0, 15, 7]), torch.tensor([1, 0, 1])
    one_hot = torch.nn.functional.one_hot(state, 16).float()
    data = TensorDict({"observation": one_hot, "trial": trial}, [3])
    assert torch.equal(policy(data)["logits"], expected[trial, :, state])


def test_other_observations_are_refused():
    with pytest.raises(ValueError, match=r"Discrete.*Box\(\["):
        TabularPolicy(make_env("CartPole-v1", trials=2))


def test_a_one_hot_of_ones_own_is_a_box():
    """What an environment calls a Box is one, even where it has the look of a one-hot."""

    class Own(gym.ObservationWrapper):
        def __init__(self):
            super().__init__(gym.make("FrozenLake-v1").unwrapped)
            self.observation_space = gym.spaces.Box(0, 1, (16,))

        def observation(self, observation):
            return torch.nn.functional.one_hot(torch.tensor(observation), 16).numpy()

    gym.register("OwnLake-v0", entry_point=Own, max_episode_steps=9)
    try:
        env = make_env("OwnLake-v0", trials=2)
        with pytest.raises(ValueError, match=r"Discrete.*Box"):
            TabularPolicy(env)
    finally:
        gym.registry.pop("OwnLake-v0")
