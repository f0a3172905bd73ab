"""Every discrete strategy in TorchRL's own collector, after a Q-network."""

import pytest
import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.envs.libs.gym import GymEnv
from torchrl.envs.utils import ExplorationType

from tests.strategies.from_files import FILES, mu, standalone
from trl_explore.strategies import ParameterNoise

pytestmark = pytest.mark.parametrize("name", FILES)


QUIET = {"auto_register_policy_transforms": True}  # torchrl 0.14 warns where it is not stated


@pytest.mark.parametrize("indices", [True, False], ids=["categorical", "one_hot"])
def test_behind_a_q_network_in_torchrls_collector(name, indices):
    env = GymEnv("CartPole-v1", categorical_action_encoding=indices)
    env.set_seed(0)
    torch.manual_seed(1)  # other weights may balance the pole for longer than a batch
    q = TensorDictModule(torch.nn.Linear(4, 2), ["observation"], ["action_value"])
    strategy = standalone(name, q, spec=env.action_spec, logits_key="action_value")
    collector = Collector(
        env, TensorDictSequential(q, strategy), frames_per_batch=60, total_frames=120, **QUIET
    )
    batches = []
    for batch in collector:
        data = batch.clone()
        batches.append(data)
        assert data.batch_size == (60,)
        action = data["action"] if indices else data["action"].int().argmax(-1)
        assert data["action"].shape == ((60,) if indices else (60, 2))
        assert env.action_spec.expand(60, *env.action_spec.shape).is_in(data["action"])
        if strategy.exact and not isinstance(strategy, ParameterNoise):
            last = int(data["is_init"].nonzero()[-1, 0])  # of its episode all frames are here
            episode = data[last:].exclude("is_init")
            probs = mu(strategy, episode, episode["action_value"])
            of_action = probs.gather(-1, action[last:].unsqueeze(-1)).squeeze(-1)
            torch.testing.assert_close(episode["action_log_prob"], of_action.log())
        # The action is the one that the environment took: pushing right speeds up.
        falling = data["next", "observation"][:, 1] - data["observation"][:, 1]
        assert torch.equal(falling > 0, action == 1)
        strategy.step()
    collector.shutdown()
    assert len(batches) == 2
    assert int(strategy.iteration) == 2


def test_evaluation_in_torchrls_collector(name):
    env = GymEnv("CartPole-v1", categorical_action_encoding=True)
    env.set_seed(0)
    q = TensorDictModule(torch.nn.Linear(4, 2), ["observation"], ["action_value"])
    policy = TensorDictSequential(q, standalone(name, q, logits_key="action_value"))
    collector = Collector(
        env,
        policy,
        frames_per_batch=40,
        total_frames=40,
        exploration_type=ExplorationType.DETERMINISTIC,
        **QUIET,
    )
    for data in collector:
        assert torch.equal(data["action"], data["action_value"].argmax(-1))
    collector.shutdown()
