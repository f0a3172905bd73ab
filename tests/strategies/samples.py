"""Any strategy, and frames with what it reads."""

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.data import Bounded, OneHot
from torchrl.envs import GymEnv

from trl_explore import strategies
from trl_explore.strategies import (
    ParameterNoise,
)

BOX = Bounded(-1.0, 1.0, shape=(2,))
OWN = [
    name
    for name in strategies.__all__
    if hasattr(getattr(strategies, name), "actions") and not name.endswith("Strategy")
]


def network(n_actions=2):
    return TensorDictModule(torch.nn.Linear(4, n_actions), ["observation"], ["logits"])


def make(name, **options):
    """Any strategy over three actions or a box of two dimensions."""
    kind = getattr(strategies, name)
    strategy = kind(spec=BOX if kind.actions == "continuous" else OneHot(3), **options)
    if isinstance(strategy, ParameterNoise):
        strategy.bind(network(3), 1)
    return strategy


def data(*batch, **entries):
    """Frames with everything that a strategy may read."""
    frames = {
        "logits": torch.randn(*batch, 3),
        "observation": torch.randn(*batch, 4),
        "loc": torch.zeros(*batch, 2),
        "scale": torch.ones(*batch, 2),
        "is_init": torch.zeros(*batch, 1, dtype=torch.bool),
    }
    return TensorDict({**frames, **entries}, batch)


def cartpole():
    return GymEnv("CartPole-v1")
