"""REINFORCE on CartPole, with the frames of two worker processes.

The collector sends the policy and the strategy to its workers; ``update_policy_weights_``
brings them the learned weights and the strategy's schedule. The loss takes the frames as they
come, [workers, environments, time]; its weights correct for the exploration.
"""

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch.distributions import Categorical
from torchrl.collectors import MultiSyncCollector
from torchrl.envs import SerialEnv
from torchrl.envs.libs.gym import GymEnv
from torchrl.modules import MLP, ProbabilisticActor

from trl_explore.objectives import ReinforceLoss
from trl_explore.objectives.baselines import StepMean
from trl_explore.objectives.corrections import PerStep
from trl_explore.strategies import EpsilonSoftmax
from trl_explore.strategies.schedules import Linear

WORKERS, ENVS, FRAMES, BATCHES = 2, 5, 2000, 12


def make_env() -> SerialEnv:
    """Copies of CartPole with actions as indices."""
    return SerialEnv(ENVS, lambda: GymEnv("CartPole-v1", categorical_action_encoding=True))


def train(seed: int = 0) -> float:
    """Mean length of the episodes in the last batch, which are cut off after 200 frames."""
    torch.manual_seed(seed)
    network = MLP(in_features=4, out_features=2, num_cells=[32])
    logits = TensorDictModule(network, ["observation"], ["logits"])
    strategy = EpsilonSoftmax(Linear(0.2, 0.0, BATCHES))
    actor = ProbabilisticActor(logits, in_keys=["logits"], distribution_class=Categorical)
    collector = MultiSyncCollector(
        [make_env] * WORKERS,
        TensorDictSequential(logits, strategy),
        frames_per_batch=FRAMES,
        total_frames=FRAMES * BATCHES,
        reset_at_each_iter=True,
        auto_register_policy_transforms=True,
    )
    collector.set_seed(seed)
    loss = ReinforceLoss(
        actor, trials=1, weight=1 / FRAMES, gamma=0.99, correction=PerStep(), baseline=StepMean()
    )
    optimizer = torch.optim.Adam(actor.parameters(), lr=0.03)
    for data in collector:
        optimizer.zero_grad()
        loss(data)["loss_actor"].backward()
        optimizer.step()
        loss.step(data)
        strategy.step()
        collector.update_policy_weights_()
    collector.shutdown()
    return FRAMES / data["collector", "traj_ids"].unique().numel()


if __name__ == "__main__":
    print(f"length of an episode: {train():.0f}")
