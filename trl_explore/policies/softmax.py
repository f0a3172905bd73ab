"""Softmax policies: linear (the thesis), tabular, and multilayer perceptron."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Unpack

from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs import EnvBase

from trl_explore.checks import withdraw
from trl_explore.policies.layers import (
    LaneLinear,
    LaneMLP,
    NetworkOptions,
    initial_weights,
    is_one_hot,
    layer_sizes,
    n_actions,
    n_features,
    observation_space,
)


class LinearPolicy(TensorDictModule):
    """The linear softmax policy: π(·|s) = softmax(W s), one W per trial (thesis, A.1).

    Reads "observation" [*batch, n_features] and "trial" [*batch] (the row of the parameters);
    writes "logits" [*batch, n_actions].

    Attributes:
        linear_softmax: whether the logits are W s, so that the gradient of log π has a closed
            form. False in a class that overrides ``forward``, unless the class declares it.
        tabular: whether the states are one-hot, so that the logits of a state are a column of W.

    Args:
        env: the environment; its specs give the layer sizes, its batch size the number of trials.
        init: the initial W, a name from ``initial_weights``.
        seed: seed of the job.
        first_trial: trial index of row 0.

    Raises:
        ValueError: if the actions are not ``Categorical``, or ``init`` is unknown.
    """

    actions = "discrete"
    linear_softmax: ClassVar[bool] = True
    tabular: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        withdraw(cls, "linear_softmax", False, ["forward"])

    def __init__(
        self, env: EnvBase, *, init: str = "glorot_uniform", seed: int = 0, first_trial: int = 0
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


class TabularPolicy(LinearPolicy):
    """π(a|s) = softmax(W[·, s])_a, one table W per trial (Sutton & Barto 2018, §13.1).

    A ``LinearPolicy`` on the one-hot state. W is initially zero, so π is initially uniform.

    Args:
        env: an environment of ``make_env`` whose observation is discrete (one-hot).
        init: the initial W [trials, n_actions, n_states], a name from ``initial_weights``.
        seed: seed of the job.
        first_trial: trial index of row 0.

    Raises:
        ValueError: if the observation is not discrete, the actions are not ``Categorical``, or
            ``init`` is unknown.

    Example:
        >>> from trl_explore.envs import make_env
        >>> TabularPolicy(make_env("FrozenLake-v1", trials=3)).weight.shape
        torch.Size([3, 4, 16])
    """

    tabular = True

    def __init__(
        self, env: EnvBase, *, init: str = "zeros", seed: int = 0, first_trial: int = 0
    ) -> None:
        if not is_one_hot(env):
            got = " ".join(str(observation_space(env)).split())
            raise ValueError(
                f"TabularPolicy needs Discrete observations and no transforms, got {got}"
            )
        super().__init__(env, init=init, seed=seed, first_trial=first_trial)


class MLPPolicy(TensorDictModule):
    """π(·|s) = softmax(MLP(s)), one multilayer perceptron (``LaneMLP``) per trial.

    Reads "observation" [*batch, n_features] and "trial" [*batch] (the row of the parameters);
    writes "logits" [*batch, n_actions].

    Args:
        env: the environment; its specs give the layer sizes, its batch size the number of trials.
        hidden: the units of every hidden layer; an empty list makes the policy linear.
        network: other arguments of ``LaneMLP``; if ``output_gain`` is small, π is initially near
            uniform.

    Raises:
        ValueError: if the actions are not ``Categorical``, or an argument is out of range.

    Example:
        >>> from trl_explore.envs import make_env
        >>> policy = MLPPolicy(make_env("CartPole-v1", trials=3), hidden=[16])
        >>> [tuple(parameter.shape) for parameter in policy.parameters()]
        [(3, 16, 4), (3, 16), (3, 2, 16), (3, 2)]
    """

    actions = "discrete"

    def __init__(
        self, env: EnvBase, *, hidden: Sequence[int] = (32, 32), **network: Unpack[NetworkOptions]
    ) -> None:
        (trials,) = env.batch_size
        module = LaneMLP(layer_sizes(env, hidden, n_actions(env)), trials, **network)
        super().__init__(module, in_keys=["observation", "trial"], out_keys=["logits"])
