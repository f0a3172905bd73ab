"""Strategies on a GPU: the same actions and probabilities as on the CPU, from the same noise."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torchrl.collectors import Collector

from tests.strategies.samples import OWN, cartpole, data, make, network
from trl_explore.strategies import EpsilonGreedy, Random, Softmax

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")

N = 512


def frames(strategy):
    g = torch.Generator().manual_seed(0)
    size = strategy.noise_size
    noise = torch.rand((N,) if size == 1 else (N, size), generator=g, dtype=torch.float64)
    after = {
        "reward": torch.ones(N, 1),
        "done": torch.ones(N, 1, dtype=torch.bool),
        "episode_reward": torch.ones(N, 1),
    }
    logits = torch.randn(N, 3, generator=g)
    observation = torch.randn(N, 4, generator=g)
    return data(
        N,
        noise=noise,
        logits=logits,
        observation=observation,
        next=TensorDict(after, [N]),
        trial=torch.zeros(N, dtype=torch.int64),
    )


@pytest.mark.parametrize("name", [name for name in OWN if name != "ParameterNoise"])
def test_the_same_draws_as_on_the_cpu(name):
    strategy = make(name, noise_key="noise")
    given = frames(strategy)
    there = strategy.to("cpu")(given.clone())
    moved = strategy.to("cuda")
    here = moved(given.to("cuda"))
    assert all(value.is_cuda for _, value in here.items(True, True))
    assert all(buffer.is_cuda for buffer in moved.buffers())
    if here["action"].is_floating_point():
        torch.testing.assert_close(here["action"].cpu(), there["action"], rtol=1e-5, atol=1e-5)
    else:  # a rounding of a probability may move the draw next to it
        equal = (here["action"].cpu() == there["action"]).reshape(N, -1).all(-1)
        assert equal.float().mean() > 0.99
        there, here = there[equal], here[equal.cuda()]
    if "action_log_prob" in there:
        log_prob = here["action_log_prob"].cpu()
        torch.testing.assert_close(log_prob, there["action_log_prob"], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", OWN)
def test_a_step_and_a_checkpoint(name):
    strategy = make(name, noise_key="noise").to("cuda")
    if name == "ParameterNoise":  # the policy moves with the sequence that both are in
        strategy.bind(network(3).to("cuda"), 1)
    given = frames(strategy).to("cuda")
    strategy(given)
    assert all(value.is_cuda for value in given.values(True, True))
    strategy.step(given)
    assert int(strategy.iteration) == 1
    assert strategy.iteration.is_cuda
    again = make(name, noise_key="noise")
    again.load_state_dict(strategy.state_dict())
    assert int(again.iteration) == 1
    assert int(again.frames) == int(strategy.frames) == N


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_other_precisions_with_a_mask(dtype):
    strategy = EpsilonGreedy(0.5).to("cuda")
    mask = torch.tensor([True, False, True], device="cuda").expand(N, 3)
    logits = torch.randn(N, 3, dtype=dtype, device="cuda")
    out = strategy(TensorDict({"logits": logits, "action_mask": mask}, [N], device="cuda"))
    assert set(out["action"].tolist()) == {0, 2}


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of torch's compiler
def test_compiled():
    strategy = Softmax(0.5, noise_key="noise").to("cuda")
    given = frames(strategy).to("cuda")
    plain = strategy(given.clone())
    compiled = torch.compile(strategy)(given.clone())
    assert torch.equal(plain["action"], compiled["action"])
    torch.testing.assert_close(plain["action_log_prob"], compiled["action_log_prob"])


@pytest.mark.parametrize("kind", [Random, EpsilonGreedy, Softmax])
def test_a_collector_with_the_policy_on_the_gpu(kind):
    env = cartpole()
    policy = TensorDictSequential(network(), kind(spec=env.action_spec))
    collector = Collector(
        env, policy, frames_per_batch=100, total_frames=200, policy_device="cuda",
        env_device="cpu", storing_device="cuda",
        auto_register_policy_transforms=True,
    )  # fmt: skip
    batches = list(collector)
    collector.shutdown()
    assert [len(batch) for batch in batches] == [100, 100]
    assert all(batch["action_log_prob"].is_cuda for batch in batches)
    assert 0 < torch.cat([batch["action"][..., 0] for batch in batches]).float().mean() < 1
