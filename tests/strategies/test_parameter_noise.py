"""Perturbed policies."""

import copy
from itertools import pairwise

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch.distributions import Categorical, kl_divergence

from trl_explore.collectors import TorchRLCollector
from trl_explore.envs import make_env
from trl_explore.numerics.streams import Stream, generator
from trl_explore.policies import LinearPolicy
from trl_explore.strategies import ParameterNoise
from trl_explore.strategies.schedules import Linear


def collector(kind, strategy, trials=4, *, seed=0, first_trial=0, max_steps=40, **options):
    torch.set_num_threads(1)
    env = make_env("CartPole-v1", trials, max_steps, seed=seed, first_trial=first_trial)
    policy = LinearPolicy(env, seed=seed, first_trial=first_trial)
    return kind(env, TensorDictSequential(policy, strategy), **options)


def noisy(**options):
    """A collector of two linear policies and the perturbation of an episode, drawn by hand."""
    strategy = ParameterNoise(**options)
    episodes = collector(TorchRLCollector, strategy, 2, seed=5, first_trial=3)

    def xi(k, episode):
        drawn = generator(5, Stream.STRATEGY, 3 + k, episode).standard_normal((2, 4))
        return torch.from_numpy(drawn)

    return episodes, xi


def test_actions_are_those_of_the_perturbed_policy():
    episodes, xi = noisy(sigma=[0.5, 2.0], temperature=1.5, threshold=None)
    weight = episodes.policy[0].weight
    for episode in range(3):
        data = episodes.collect().frames
        for k, sigma in enumerate((0.5, 2.0)):
            own = data[data["trial"] == k]
            perturbed = weight[k].detach() + (sigma * xi(k, episode)).float()
            probs = torch.softmax(own["observation"] @ perturbed.T / 1.5, -1)
            drawn = probs.gather(1, own["action"].unsqueeze(1)).squeeze(1)
            torch.testing.assert_close(own["action_log_prob"], drawn.log(), rtol=1e-4, atol=1e-5)
            noise = generator(5, Stream.ACTION, 3 + k, episode).random(len(own))
            expected = (noise >= probs[:, 0].numpy()).astype(int)
            np.testing.assert_array_equal(own["action"].numpy(), expected)
        episodes.strategy.step(data)


@pytest.mark.parametrize("per_update", [1, 2])
def test_sigma_adapts_to_the_distance_of_the_last_episode(per_update):
    strategy = ParameterNoise(sigma=[0.01, 5.0], threshold=0.05, factor=1.25)
    episodes = collector(
        TorchRLCollector, strategy, 2, seed=5, first_trial=3, episodes_per_update=per_update
    )
    data = episodes.collect().frames
    weight = episodes.policy[0].weight.detach().clone()
    episodes.policy[0].weight.data += 3.0  # the update comes before the step: it plays no role
    distances, frames = strategy._distance(data[-1:])  # one frame, of trial 1
    draws = generator(5, Stream.STRATEGY, 4, per_update - 1).standard_normal((2, 4))
    logits = data["observation"][-1] @ weight[1].T
    other = data["observation"][-1] @ (weight[1] + torch.from_numpy(5.0 * draws).float()).T
    expected = kl_divergence(Categorical(logits=logits), Categorical(logits=other))
    np.testing.assert_allclose(distances, [0, expected.item()], rtol=1e-4)
    assert frames.tolist() == [0, 1]
    strategy.step(data)
    np.testing.assert_allclose(strategy.scale, [1.25, 1 / 1.25], rtol=1e-12)
    strategy.step(data[data["trial"] == 0])  # a stopped trial keeps its own
    np.testing.assert_allclose(strategy.scale, [1.25**2, 1 / 1.25], rtol=1e-12)


def test_without_a_threshold_sigma_is_its_schedule():
    episodes, xi = noisy(sigma=Linear(1.0, 0.0, iterations=4), threshold=None)
    for i, sigma in enumerate((1.0, 0.75, 0.5)):
        data = episodes.collect().frames
        center = episodes.policy[0].weight.detach()
        (perturbed,) = episodes.strategy.behaviour_parameters([episodes.policy[0].weight])
        for k in range(2):
            expected = (sigma * xi(k, i)).float()
            torch.testing.assert_close(perturbed[k] - center[k], expected, rtol=1e-4, atol=1e-6)
        episodes.strategy.step(data)


def lanes(first, observation=None):
    """Two lanes of a TorchRL environment."""
    observation = torch.ones(2, 3) if observation is None else observation
    marks = torch.tensor(first).unsqueeze(-1)
    return TensorDict({"observation": observation, "is_init": marks}, [2])


def single(**options):
    """Noise on a policy that knows nothing of trials."""
    network = torch.nn.Sequential(torch.nn.Linear(3, 5), torch.nn.Tanh(), torch.nn.Linear(5, 2))
    policy = TensorDictModule(network, ["observation"], ["logits"])
    strategy = ParameterNoise(**options)
    strategy.bind(policy, 1)
    return strategy, policy


def test_any_parameters_of_a_single_policy_are_perturbed():
    strategy, policy = single(sigma=0.5)
    before = [p.clone() for p in policy.parameters()]
    data = policy(lanes([True, True]))
    changed = strategy.preferences(data, data["logits"])
    assert not torch.isclose(changed, data["logits"]).any()
    assert all(torch.equal(a, b) for a, b in zip(before, policy.parameters(), strict=True))
    with pytest.raises(ValueError, match=r"2 trials.*module\.0\.weight.*\[5, 3\]"):
        strategy.bind(policy, 2)


def test_every_lane_has_a_perturbation_of_its_own_for_each_episode():
    strategy, _ = single(sigma=0.5)
    starts = [[True, True], [False, False], [True, False], [False, True], [False, False]]
    seen = [strategy.preferences(lanes(first), torch.zeros(2, 2)) for first in starts]
    same = [[torch.equal(a[k], b[k]) for k in range(2)] for a, b in pairwise(seen)]
    assert same == [[True, True], [False, True], [True, False], [True, True]]
    assert not torch.isclose(seen[0][0], seen[0][1]).any()


def test_the_perturbation_of_a_lane_by_hand():
    strategy, policy = single(sigma=0.5)
    observation = torch.randn(2, 3)
    found = strategy.preferences(lanes([True, True], observation), torch.zeros(2, 2))
    for k in range(2):
        moved, start = copy.deepcopy(policy), 0
        for parameter in moved.parameters():
            n = parameter.numel()
            shift = 0.5 * strategy._xi[k, start : start + n].reshape(parameter.shape)
            parameter.data += shift
            start += n
        torch.testing.assert_close(found[k], moved.module(observation[k]))


def test_sigma_adapts_to_the_distance_of_the_frames_seen():
    for sigma, grows in ((1e-4, True), (20.0, False)):
        strategy, policy = single(sigma=sigma, threshold=0.05, factor=1.25)
        for _ in range(3):
            strategy(policy(lanes([True, True])))
        strategy.step(6)
        assert strategy.scale.tolist() == [1.25 if grows else 1 / 1.25]
        strategy.step(0)  # nothing seen since
        assert strategy.scale.tolist() == [1.25 if grows else 1 / 1.25]


def test_noise_on_a_policy_that_is_not_known_is_an_error():
    data = TensorDict({"logits": torch.zeros(2)})
    with pytest.raises(ValueError, match=r"bind\(policy, trials\)"):
        ParameterNoise()(data)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"sigma": -0.1}, "sigma"),
        ({"temperature": -1.0}, "temperature"),
        ({"threshold": 0.0}, "threshold"),
        ({"factor": 1.0}, "factor"),
    ],
)
def test_parameter_noise_refuses(options, name):
    with pytest.raises(ValueError, match=rf"^{name}\b"):
        ParameterNoise(**options)


class Branching(torch.nn.Linear):
    """A layer with a branch on data, as in TorchRL's recurrent modules, for a batch of frames."""

    def forward(self, x):
        assert x.ndim == 2
        return super().forward(x) if x.sum() > -1e9 else x


def test_a_policy_that_vmap_cannot_map_has_a_perturbation_for_every_lane():
    policy = TensorDictModule(Branching(4, 3), ["observation"], ["logits"])
    strategy = ParameterNoise(1.0)
    strategy.bind(policy, 1)
    frames = {"observation": torch.ones(5, 4), "is_init": torch.zeros(5, 1, dtype=torch.bool)}
    data = policy(TensorDict(frames, [5]))
    found = strategy.preferences(data, data["logits"])
    assert torch.equal(found, strategy.preferences(data, data["logits"]))
    assert len(found.unique(dim=0)) == 5
    strategy.sigma.zero_()
    torch.testing.assert_close(strategy.preferences(data, data["logits"]), data["logits"])
