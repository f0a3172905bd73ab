"""The linear-softmax policy of the thesis."""

from __future__ import annotations

from typing import Any

from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs import EnvBase

from trl_explore.policies.base import n_actions, n_features
from trl_explore.policies.initial import initial_weights
from trl_explore.policies.lanes import LaneLinear


class LinearPolicy(TensorDictModule):
    """The linear-softmax policy: π(·|s) = softmax(W s), one W for each trial (thesis, A.1).

    Reads "observation" [*batch, n_features] and "trial" [*batch] (the row of the parameters);
    writes "logits" [*batch, n_actions]. Nothing about exploration is in it.

    Args:
        env: the environment, whose specs give the sizes and whose batch size the trials.
        init: how W begins, a name of ``initial_weights``.
        seed: seed of the job.
        first_trial: trial index of row 0.

    Raises:
        ValueError: if the actions are not ``Categorical``, or ``init`` is unknown.
    """

    actions = "discrete"

    def __init__(
        self,
        env: EnvBase,
        *,
        init: str = "glorot_uniform",
        seed: int = 0,
        first_trial: int = 0,
    ) -> None:
        (trials,) = env.batch_size
        sizes = [n_features(env), n_actions(env)]
        (weight,) = initial_weights(sizes, trials, init, seed=seed, first_trial=first_trial)
        super().__init__(LaneLinear(weight), in_keys=["observation", "trial"], out_keys=["logits"])

    @property
    def weight(self) -> nn.Parameter:
        """W [trials, n_actions, n_features]."""
        module: Any = self.module
        return module.weight
