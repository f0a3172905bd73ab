"""PPO on CartPole, with data of a behaviour policy that is not the target policy.

``EpsilonSoftmax`` writes the exact log-probability under μ, the mixture that drew the action.
PPO's ratio is π/μ, so it corrects for the exploration as well.
"""

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch.distributions import Categorical
from torchrl.collectors import Collector
from torchrl.envs import SerialEnv
from torchrl.envs.libs.gym import GymEnv
from torchrl.modules import MLP, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from trl_explore.strategies import EpsilonSoftmax

ENVS, FRAMES, BATCHES, EPOCHS, EPSILON = 10, 1000, 20, 10, 0.1


def make_env() -> GymEnv:
    """CartPole with actions as indices."""
    return GymEnv("CartPole-v1", categorical_action_encoding=True)


def train(seed: int = 0) -> float:
    """Mean return of five episodes of the policy without exploration."""
    torch.manual_seed(seed)
    env = SerialEnv(ENVS, make_env)
    env.set_seed(seed)
    network = MLP(in_features=4, out_features=2, num_cells=[64], activation_class=torch.nn.Tanh)
    logits = TensorDictModule(network, ["observation"], ["logits"])
    actor = ProbabilisticActor(logits, in_keys=["logits"], distribution_class=Categorical)
    behaviour = TensorDictSequential(logits, EpsilonSoftmax(EPSILON))
    critic = ValueOperator(
        MLP(in_features=4, out_features=1, num_cells=[64], activation_class=torch.nn.Tanh),
        in_keys=["observation"],
    )
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic, average_gae=True)
    loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_coeff=0.0)
    loss.set_keys(sample_log_prob="action_log_prob")
    optimizer = torch.optim.Adam(loss.parameters(), lr=3e-3)
    collector = Collector(
        env,
        behaviour,
        frames_per_batch=FRAMES,
        total_frames=FRAMES * BATCHES,
        auto_register_policy_transforms=True,
    )
    for data in collector:
        with torch.no_grad():
            advantage(data)
        for _ in range(EPOCHS):
            losses = loss(data.reshape(-1))
            optimizer.zero_grad()
            (losses["loss_objective"] + losses["loss_critic"]).backward()
            optimizer.step()
        assert (data["action_log_prob"].exp() >= EPSILON / 2 - 1e-6).all()
    collector.shutdown()

    env = make_env()
    env.set_seed(seed + 1000)
    with torch.no_grad():
        returns = [env.rollout(500, actor)["next", "reward"].sum().item() for _ in range(5)]
    return sum(returns) / len(returns)


if __name__ == "__main__":
    print(f"return of the policy: {train():.0f}")
