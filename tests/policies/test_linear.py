import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.envs.libs.gym import GymEnv

from trl_explore.envs import make_env
from trl_explore.policies import (
    LaneLinear,
    LinearPolicy,
    initial_weights,
    n_actions,
)


@pytest.fixture(scope="module")
def env():
    env = make_env("CartPole-v1", trials=30)
    yield env
    env.close()


def test_sizes_come_from_the_specs(env):
    policy = LinearPolicy(env)
    assert policy.weight.shape == (30, 2, 4)
    assert [name for name, _ in policy.named_parameters()] == ["module.weight"]  # no bias
    acrobot = make_env("Acrobot-v1", trials=2)
    assert LinearPolicy(acrobot).weight.shape == (2, 3, 6)
    acrobot.close()


def test_policy_has_the_weights_of_its_trials(env):
    policy = LinearPolicy(env, seed=5, first_trial=11)
    assert torch.equal(policy.weight, initial_weights([4, 2], 30, seed=5, first_trial=11)[0])
    assert policy.weight.requires_grad


def test_logits_by_hand():
    weight = torch.tensor([[[1.0, 0.0], [0.0, 2.0]], [[1.0, 1.0], [0.0, -1.0]]])
    policy = TensorDictModule(LaneLinear(weight), ["observation", "trial"], ["logits"])
    data = TensorDict(
        {
            "observation": torch.tensor([[3.0, 4.0], [3.0, 4.0], [0.0, 1.0]]),
            "trial": torch.tensor([1, 0, 1]),
        },
        [3],
    )
    assert policy(data)["logits"].tolist() == [[7.0, -4.0], [3.0, 8.0], [1.0, -1.0]]


def test_policy_writes_logits_and_nothing_else(env):
    policy = LinearPolicy(env)
    assert policy.in_keys == ["observation", "trial"]
    assert policy.out_keys == ["logits"]
    for batch in ([30], [7], [3, 5], []):
        data = TensorDict(
            {"observation": torch.randn(*batch, 4), "trial": torch.randint(30, batch)}, batch
        )
        out = policy(data.clone())
        assert set(out.keys()) == {"observation", "trial", "logits"}
        expected = torch.einsum(
            "...oi,...i->...o", policy.weight[data["trial"]], data["observation"]
        )
        torch.testing.assert_close(out["logits"], expected)


def test_number_of_actions(env):
    assert n_actions(env) == 2


@pytest.mark.parametrize(("id", "kind"), [("Pendulum-v1", "Bounded"), ("CartPole-v1", "OneHot")])
def test_number_of_actions_of_another_spec(id, kind):
    other = GymEnv(id)
    with pytest.raises(ValueError, match=f"Categorical.*{kind}"):
        n_actions(other)
    other.close()


def test_another_beginning(env):
    policy = LinearPolicy(env, init="he_normal", seed=5, first_trial=11)
    (expected,) = initial_weights([4, 2], 30, "he_normal", seed=5, first_trial=11)
    assert torch.equal(policy.weight, expected)
