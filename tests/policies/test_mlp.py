import pytest
import torch
from tensordict import TensorDict

from trl_explore.envs import make_env
from trl_explore.policies import LaneMLP, LinearPolicy, MLPPolicy, initial_weights


@pytest.fixture(scope="module")
def env():
    env = make_env("CartPole-v1", trials=30)
    yield env
    env.close()


def test_by_hand():
    """One unit of each layer: y = 3 relu(2 x − 1) + 0.5, mirrored in the second trial."""
    mlp = LaneMLP([1, 1, 1], 2, "relu")
    values = [[[[2.0]], [[-2.0]]], [[-1.0], [-1.0]], [[[3.0]], [[3.0]]], [[0.5], [0.5]]]
    for parameter, value in zip(mlp.parameters(), values, strict=True):
        parameter.data = torch.tensor(value)
    x, trial = torch.tensor([[2.0], [2.0], [-2.0], [0.0]]), torch.tensor([0, 1, 1, 0])
    assert mlp(x, trial).tolist() == [[9.5], [0.5], [9.5], [0.5]]


def test_gradcheck():
    mlp = LaneMLP([3, 9, 4, 2], 2, "tanh").double()
    x = torch.randn(5, 3, dtype=torch.float64, requires_grad=True)
    trial = torch.tensor([0, 1, 1, 1, 0])
    parameters = tuple(mlp.parameters())

    def output(x, *values):
        names = [name for name, _ in mlp.named_parameters()]
        return torch.func.functional_call(mlp, dict(zip(names, values, strict=True)), (x, trial))

    assert torch.autograd.gradcheck(output, (x, *parameters))


@pytest.mark.parametrize("activation", ["tanh", "relu"])
@pytest.mark.parametrize("batch", [(), (7,), (3, 5), (0,)])
def test_against_torch(activation, batch):
    mlp = LaneMLP([4, 32, 16, 2], 30, activation)
    draws = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in mlp.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape, generator=draws))
    x = torch.randn(*batch, 4, generator=draws)
    trial = torch.randint(30, batch, generator=draws)
    expected = x
    for i, layer in enumerate(mlp.layers):
        expected = torch.einsum("...oi,...i->...o", layer.weight[trial], expected)
        expected = expected + layer.bias[trial]
        if i < 2:
            expected = getattr(torch, activation)(expected)
    torch.testing.assert_close(mlp(x, trial), expected)


def test_sizes_and_weights(env):
    policy = MLPPolicy(env, hidden=[8, 5], seed=5, first_trial=11, init="he_normal")
    shapes = [tuple(parameter.shape) for parameter in policy.parameters()]
    assert shapes == [(30, 8, 4), (30, 8), (30, 5, 8), (30, 5), (30, 2, 5), (30, 2)]
    expected = initial_weights([4, 8, 5, 2], 30, "he_normal", seed=5, first_trial=11)
    for layer, weight in zip(policy.module.layers, expected, strict=True):
        assert torch.equal(layer.weight, weight)
        assert not layer.bias.any()
    assert len(list(MLPPolicy(env, hidden=[8], bias=False).parameters())) == 2


def test_without_a_hidden_layer_it_is_the_linear_policy(env):
    policy, linear = MLPPolicy(env, hidden=[], bias=False), LinearPolicy(env)
    data = TensorDict({"observation": torch.randn(9, 4), "trial": torch.arange(9)}, [9])
    assert torch.equal(policy(data.clone())["logits"], linear(data.clone())["logits"])


def test_a_trial_does_not_depend_on_its_neighbours(env):
    together = MLPPolicy(env)
    draws = torch.Generator().manual_seed(2)
    x, trial = torch.randn(300, 4, generator=draws), torch.randint(30, (300,), generator=draws)
    for k in (0, 13, 29):
        alone = MLPPolicy(make_env(trials=1, first_trial=k), first_trial=k)
        rows = trial == k
        own = alone.module(x[rows], torch.zeros(int(rows.sum()), dtype=torch.int64))
        assert torch.equal(own, together.module(x, trial)[rows])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hidden": 32}, r"^hidden.*\[32, 32\].*32$"),
        ({"hidden": "32"}, "^hidden.*'32'"),
        ({"hidden": [8, 0]}, "layer.*>= 1.*0$"),
        ({"activation": "gelu"}, "^activation.*tanh.*relu.*'gelu'"),
        ({"init": "zeros"}, "^init.*'zeros'.*gradient"),
        ({"init": "ones"}, "^init.*'ones'"),
        ({"bias": "yes"}, "^bias.*'yes'"),
    ],
)
def test_wrong_arguments(env, options, message):
    with pytest.raises(ValueError, match=message):
        MLPPolicy(env, **options)


def test_zeros_without_hidden_layers(env):
    assert not any(p.any() for p in MLPPolicy(env, hidden=[], init="zeros").parameters())
