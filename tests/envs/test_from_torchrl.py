"""TorchRL environments, one for each trial."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Categorical, Composite, OneHot, Unbounded
from torchrl.envs import EnvBase, PendulumEnv

from trl_explore.envs import lane_env, make_env
from trl_explore.envs.gym import make_gym


class Walk(EnvBase):
    """A walk on the integers that ends at 3 or -3; a step fails with some probability."""

    def __init__(self, fails: float = 0.0, batch_size=(), one_hot: bool = False) -> None:
        super().__init__(batch_size=batch_size)
        self.fails, self.one_hot = fails, one_hot
        shape = self.batch_size
        self.observation_spec = Composite(place=Unbounded((*shape, 1)), shape=shape)
        self.action_spec = OneHot(2, shape=(*shape, 2)) if one_hot else Categorical(2, shape=shape)
        self.reward_spec = Unbounded((*shape, 1))

    def _reset(self, tensordict):
        place = torch.zeros(*self.batch_size, 1)
        return TensorDict({"place": place}, self.batch_size)

    def _step(self, tensordict):
        action = tensordict["action"]
        index = action.int().argmax(-1) if self.one_hot else action
        fails = torch.rand((), generator=self.generator) < self.fails
        move = 0 if fails else 2 * index.reshape(*self.batch_size, 1) - 1
        place = tensordict["place"] + move
        terminated = place.abs() >= 3
        data = {"place": place, "reward": -torch.ones_like(place)}
        return TensorDict(
            {**data, "terminated": terminated, "done": terminated.clone()}, self.batch_size
        )

    def _set_seed(self, seed):
        self.generator = torch.Generator().manual_seed(seed)


TARGET = f"torchrl:{__name__}.Walk"


def play(trials: int = 2, first_trial: int = 0, **kwargs):
    env = make_env(TARGET, trials, 9, first_trial=first_trial, kwargs=kwargs)
    actions = torch.ones(trials, dtype=torch.int64)
    return env.rollout(
        9, lambda td: td.set("action", actions), break_when_all_done=True, break_when_any_done=False
    )


@pytest.mark.parametrize("kwargs", [{}, {"one_hot": True}, {"batch_size": (1,)}])
def test_it_is_stepped(kwargs):
    data = play(**kwargs)
    assert data["next", "observation"][0].flatten().tolist() == [1, 2, 3]
    assert data["next", "terminated"][0].flatten().tolist() == [False, False, True]
    assert data["next", "episode_reward"][1].flatten().tolist() == [-1, -2, -3]


def test_a_trial_is_the_same_alone():
    together, alone = play(3, fails=0.5), play(1, 1, fails=0.5)
    length = alone.shape[1]
    assert (together["next", "observation"][1, :length] == alone["next", "observation"][0]).all()
    ends = together["next", "step_count"].amax((1, 2)).tolist()
    assert len(set(ends)) > 1 or (together["observation"][0] != together["observation"][1]).any()


def test_several_observations_are_one_vector():
    env = make_env("torchrl:torchrl.envs.PendulumEnv", 2, 5)
    data = env.rollout(5)
    reference = PendulumEnv()
    n = sum(spec.shape.numel() for spec in reference.observation_spec.values(True, True))
    assert data["observation"].shape == (2, 5, n)
    assert isinstance(env.action_spec, Bounded)
    assert data["next", "truncated"][:, -1].all()


@pytest.mark.parametrize(
    ("id", "kwargs", "message"),
    [
        ("torchrl:no_module.Env", {}, "no class 'no_module.Env'"),
        ("torchrl:Env", {}, "no class 'Env'"),
        ("torchrl:torchrl.envs.No", {}, "no class 'torchrl.envs.No'"),
        ("torchrl:builtins.dict", {}, "dict makes a dict, not a torchrl"),
        (TARGET, {"batch_size": (4,)}, r"batch size \[4\], but must have \[\]"),
        (TARGET, {"no": 1}, "Walk rejects its arguments: TypeError.*'no'"),
    ],
)
def test_wrong_input_is_one_clear_line(id, kwargs, message):
    with pytest.raises(ValueError, match=message) as raised:
        make_gym(id, 5, kwargs)
    assert "\n" not in str(raised.value)


def test_a_time_limit_is_needed():
    with pytest.raises(ValueError, match="no registered time limit; set env"):
        make_env(TARGET, 2)
    assert lane_env(make_env(TARGET, 2, 7)).max_steps == 7
