"""Taxi with its action mask: Q-learning on a table, with ε-greedy over the legal actions only.

The environment says in "action_mask" which actions do something. The strategy never draws
another one, also when it explores, and its probabilities are exact under the mask.
"""

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import Binary
from torchrl.envs import ExplorationType, SerialEnv, set_exploration_type
from torchrl.envs.gym_like import default_info_dict_reader
from torchrl.envs.libs.gym import GymEnv

from trl_explore.strategies import EpsilonGreedy

ENVS, FRAMES, BATCHES, GAMMA = 20, 1000, 20, 0.98


def make_env() -> GymEnv:
    """Taxi with the mask of its info."""
    env = GymEnv("Taxi-v4", categorical_action_encoding=True)
    mask = {"action_mask": Binary(6, dtype=torch.int8)}
    return env.set_info_dict_reader(default_info_dict_reader(["action_mask"], mask))


def train(seed: int = 0) -> float:
    """Mean return of twenty greedy episodes after training; a random policy has about −200."""
    torch.manual_seed(seed)
    env = SerialEnv(ENVS, make_env)
    env.set_seed(seed)
    table = torch.zeros(500, 6)
    values = TensorDictModule(lambda state: table[state], ["observation"], ["q"])
    strategy = EpsilonGreedy(0.2, logits_key="q")
    policy = TensorDictSequential(values, strategy)
    collector = Collector(
        env,
        policy,
        frames_per_batch=FRAMES,
        total_frames=FRAMES * BATCHES,
        auto_register_policy_transforms=True,
    )
    seen = []
    for data in collector:
        legal = data["action_mask"].gather(-1, data["action"].unsqueeze(-1))
        assert legal.all()
        seen.append(data.reshape(-1))
        memory = torch.cat(seen)
        state, action = memory["observation"], memory["action"]
        after = memory["next"]
        for _ in range(20):  # the environment is deterministic: a step size of 1
            best = table[after["observation"]]
            best = best.masked_fill(after["action_mask"] == 0, -torch.inf).amax(-1, keepdim=True)
            target = after["reward"] + GAMMA * best * ~after["terminated"]
            table[state, action] = target.squeeze(-1)
    collector.shutdown()

    env = make_env()
    env.set_seed(seed + 1000)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        returns = [env.rollout(200, policy)["next", "reward"].sum().item() for _ in range(20)]
    return sum(returns) / len(returns)


if __name__ == "__main__":
    print(f"greedy return: {train():.1f}")
