"""Softmax over a table, for environments with finitely many states."""

from __future__ import annotations

from torchrl.envs import EnvBase

from trl_explore.policies.base import is_one_hot, observation_space
from trl_explore.policies.linear import LinearPolicy


class TabularPolicy(LinearPolicy):
    """π(a|s) = softmax(W[·, s])_a, one table W for each trial (Sutton & Barto 2018, §13.1).

    A ``LinearPolicy`` on the one-hot state, zero at first: π begins uniform.

    Args:
        env: an environment of ``make_env`` whose observation is discrete (one-hot).
        init: how W [trials, n_actions, n_states] begins, a name of ``initial_weights``.
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

    def __init__(
        self, env: EnvBase, *, init: str = "zeros", seed: int = 0, first_trial: int = 0
    ) -> None:
        if not is_one_hot(env):
            space = " ".join(str(observation_space(env)).split())
            raise ValueError(f"a table needs Discrete observations, got {space}")
        super().__init__(env, init=init, seed=seed, first_trial=first_trial)
