"""Two agents learn to meet on a ring, each with its own policy, exploration and return.

The strategy and the REINFORCE loss only need the names of the group's entries.
"""

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch.distributions import Categorical as CategoricalDistribution
from torchrl.data import Categorical, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase
from torchrl.modules import MultiAgentMLP, ProbabilisticActor

from trl_explore.objectives import ReinforceLoss
from trl_explore.strategies import Softmax

CELLS, STEPS, ROWS, UPDATES = 7, 10, 64, 100
ACTION, LOGITS, REWARD = ("agents", "action"), ("agents", "logits"), ("agents", "reward")


class Ring(EnvBase):
    """Agents move by −1, 0 or 1; both get 1 on the same cell, and −0.1 for a move of their own."""

    def __init__(self) -> None:
        super().__init__(batch_size=[ROWS])
        self.observation_spec = self.group("observation", Unbounded((ROWS, 2, CELLS)))
        self.action_spec = self.group("action", Categorical(3, shape=(ROWS, 2)))
        self.reward_spec = self.group("reward", Unbounded((ROWS, 2, 1)))

    def group(self, name: str, spec: TensorSpec) -> Composite:
        """The spec of an entry of the group of agents."""
        return Composite(agents=Composite({name: spec}, shape=[ROWS, 2]), shape=[ROWS])

    def _observe(self) -> TensorDict:
        way = torch.stack([self.cell[:, 1] - self.cell[:, 0], self.cell[:, 0] - self.cell[:, 1]], 1)
        seen = torch.nn.functional.one_hot(way % CELLS, CELLS).float()
        done = torch.full((ROWS, 1), self.time == STEPS)
        data = {"agents": {"observation": seen}, "done": done, "terminated": done.clone()}
        return TensorDict(data, [ROWS])

    def _reset(self, tensordict=None, **_: object) -> TensorDict:
        self.time, self.cell = 0, torch.randint(CELLS, (ROWS, 2), generator=self.generator)
        return self._observe()

    def _step(self, tensordict: TensorDict) -> TensorDict:
        move = tensordict[ACTION] - 1
        self.time, self.cell = self.time + 1, (self.cell + move) % CELLS
        met = (self.cell[:, :1] == self.cell[:, 1:]).float()
        return self._observe().set(REWARD, (met - 0.1 * move.abs()).unsqueeze(-1))

    def _set_seed(self, seed: int | None) -> None:
        self.generator = torch.Generator().manual_seed(seed or 0)


def train(seed: int = 0) -> float:
    """Mean return of an agent after training: at most 10, about 0.8 for random moves."""
    torch.manual_seed(seed)
    env = Ring()
    env.set_seed(seed)
    network = MultiAgentMLP(CELLS, 3, 2, centralized=False, share_params=False, depth=0)
    logits = TensorDictModule(network, [("agents", "observation")], [LOGITS])
    policy = TensorDictSequential(logits, Softmax(logits_key=LOGITS, action_key=ACTION))
    actor = ProbabilisticActor(
        logits, in_keys={"logits": LOGITS}, distribution_class=CategoricalDistribution
    )
    loss = ReinforceLoss(actor, trials=1, weight=1 / ROWS, gamma=0.9, normalize_advantage=True)
    loss.set_keys(action=ACTION, reward=REWARD)
    optimizer = torch.optim.Adam(loss.parameters(), lr=0.1)
    for _ in range(UPDATES):
        with torch.no_grad():
            data = env.rollout(STEPS, policy)
        optimizer.zero_grad()
        loss(data)["loss_actor"].backward()
        optimizer.step()
    return data["next", "agents", "reward"].sum(1).mean().item()


if __name__ == "__main__":
    print(f"return of an agent: {train():.2f}")
