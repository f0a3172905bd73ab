"""DQN on CartPole, with a strategy in place of TorchRL's EGreedyModule.

``EpsilonGreedy`` reads the action values, follows a schedule of its own, and also writes
the exact log-probability of every action.
"""

import torch
from tensordict.nn import TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import ExplorationType, SerialEnv, set_exploration_type
from torchrl.envs.libs.gym import GymEnv
from torchrl.modules import MLP, QValueActor
from torchrl.objectives import DQNLoss, SoftUpdate

from trl_explore.strategies import EpsilonGreedy
from trl_explore.strategies.schedules import Linear

ENVS, FRAMES, BATCHES, UPDATES = 10, 100, 80, 20


def train(seed: int = 0) -> float:
    """Mean return of five greedy episodes after training."""
    torch.manual_seed(seed)
    env = SerialEnv(ENVS, lambda: GymEnv("CartPole-v1"))
    env.set_seed(seed)
    spec = env.action_spec_unbatched
    network = MLP(in_features=4, out_features=2, num_cells=[64, 64])
    actor = QValueActor(network, in_keys=["observation"], spec=spec)
    # instead of EGreedyModule(spec=spec, annealing_num_steps=...)
    strategy = EpsilonGreedy(Linear(1.0, 0.05, 40), spec=spec, logits_key="action_value")
    policy = TensorDictSequential(actor, strategy)

    loss = DQNLoss(actor, delay_value=True)
    loss.make_value_estimator(gamma=0.99)
    target = SoftUpdate(loss, tau=0.02)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-3)
    buffer = ReplayBuffer(storage=LazyTensorStorage(FRAMES * BATCHES), batch_size=128)
    collector = Collector(
        env,
        policy,
        frames_per_batch=FRAMES,
        total_frames=FRAMES * BATCHES,
        auto_register_policy_transforms=True,
    )
    for data in collector:
        buffer.extend(data.reshape(-1))
        for _ in range(UPDATES):
            optimizer.zero_grad()
            loss(buffer.sample())["loss"].backward()
            optimizer.step()
            target.step()
        strategy.step()  # advances the schedule
    collector.shutdown()

    env = GymEnv("CartPole-v1")
    env.set_seed(seed + 1000)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        returns = [env.rollout(500, policy)["next", "reward"].sum().item() for _ in range(5)]
    return sum(returns) / len(returns)


if __name__ == "__main__":
    print(f"greedy return: {train():.0f}")
