"""Policies: (observation, trial) -> logits, with independent parameters for every trial."""

from __future__ import annotations

import math

import numpy as np
import torch
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.data import Categorical
from torchrl.envs import EnvBase

from trl_explore.ops import lane_linear
from trl_explore.streams import Stream, generator


def glorot_uniform(
    trials: int, n_out: int, n_in: int, *, seed: int = 0, first_trial: int = 0
) -> Tensor:
    """Weights W ~ U(−b, b), b = √(6 / (n_in + n_out)), for every trial from a stream of its own.

    The bound is that of one trial's layer (Glorot & Bengio 2010, eq. 16; the initialiser of the
    thesis's ``slim.fully_connected``).

    Returns:
        [trials, n_out, n_in] float32.
    """
    bound = math.sqrt(6 / (n_in + n_out))
    weight = np.empty((trials, n_out, n_in), dtype=np.float32)
    for lane in range(trials):
        draws = generator(seed, Stream.WEIGHTS, first_trial + lane)
        weight[lane] = draws.uniform(-bound, bound, (n_out, n_in))
    return torch.from_numpy(weight)


class LaneLinear(nn.Module):
    """logits = W[trial] observation, without bias; ``weight`` is [trials, n_actions, n_features].

    Args:
        weight: the initial weights.
    """

    def __init__(self, weight: Tensor) -> None:
        super().__init__()
        self.weight = nn.Parameter(weight)

    def forward(self, observation: Tensor, trial: Tensor) -> Tensor:
        """[*batch, n_features], [*batch] -> [*batch, n_actions]."""
        return lane_linear(observation, self.weight, trial)


class LinearPolicy(TensorDictModule):
    """The linear-softmax policy: π(·|s) = softmax(W s), one W for each trial (thesis, A.1).

    Reads "observation" [*batch, n_features] and "trial" [*batch] (the row of the parameters);
    writes "logits" [*batch, n_actions]. Nothing about exploration is in it.

    Args:
        env: the environment, whose specs give the sizes and whose batch size the trials.
        seed: seed of the job.
        first_trial: trial index of row 0.
    """

    def __init__(self, env: EnvBase, *, seed: int = 0, first_trial: int = 0) -> None:
        (trials,) = env.batch_size
        n_features = env.observation_spec["observation"].shape[-1]
        weight = glorot_uniform(
            trials, n_actions(env), n_features, seed=seed, first_trial=first_trial
        )
        super().__init__(LaneLinear(weight), in_keys=["observation", "trial"], out_keys=["logits"])

    @property
    def weight(self) -> nn.Parameter:
        """W [trials, n_actions, n_features]."""
        return self.module.weight  # type: ignore[return-value]


def n_actions(env: EnvBase) -> int:
    """The number of actions of an environment with a Categorical action spec."""
    spec = env.action_spec
    if not isinstance(spec, Categorical):
        raise ValueError(
            f"a softmax policy needs a Categorical action spec, got {type(spec).__name__}"
        )
    return spec.n
