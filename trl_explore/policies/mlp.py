"""The multilayer perceptron with a softmax on top."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict.nn import TensorDictModule
from torchrl.envs import EnvBase

from trl_explore.policies.policy import LaneMLP, n_actions, n_features


class MLPPolicy(TensorDictModule):
    """π(·|s) = softmax(MLP(s)), one multilayer perceptron (``LaneMLP``) for each trial.

    Reads "observation" [*batch, n_features] and "trial" [*batch] (the row of the parameters);
    writes "logits" [*batch, n_actions].

    Args:
        env: the environment, whose specs give the sizes and whose batch size the trials.
        hidden: the units of every hidden layer; an empty list makes the policy linear.
        activation: "tanh" or "relu".
        bias: whether the layers have biases, which begin at 0.
        init: how weights begin, a name of ``initial_weights``.
        output_gain: factor of the last layer's initial weights; with a small one π begins nearly
            uniform.
        seed: seed of the job.
        first_trial: trial index of row 0.

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
        self,
        env: EnvBase,
        *,
        hidden: Sequence[int] = (32, 32),
        activation: str = "tanh",
        bias: bool = True,
        init: str = "glorot_uniform",
        output_gain: float = 1.0,
        seed: int = 0,
        first_trial: int = 0,
    ) -> None:
        if isinstance(hidden, str) or not isinstance(hidden, Sequence):
            raise ValueError(f"hidden must be a list of sizes such as [32, 32], got {hidden!r}")
        (trials,) = env.batch_size
        network = LaneMLP(
            [n_features(env), *hidden, n_actions(env)],
            trials,
            activation,
            init,
            seed,
            first_trial,
            bias=bias,
            output_gain=output_gain,
        )
        super().__init__(network, in_keys=["observation", "trial"], out_keys=["logits"])
