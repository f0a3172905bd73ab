"""Full exploitation of a Gaussian policy."""

from __future__ import annotations

from trl_explore.strategies.continuous.mixture import ContinuousMixture, ContinuousMixtureStrategy


class MeanAction(ContinuousMixtureStrategy):
    """The action that the policy prefers: the mean of its Gaussian, the counterpart of argmax.

    μ(·|s) = δ(loc(s))      (Silver et al. 2014, "Deterministic policy gradient algorithms", §3)

    There is no density: the strategy writes no "action_log_prob", and no importance weight exists.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> state = TensorDict({"loc": torch.tensor([0.5, -2.0]), "scale": torch.ones(2)})
        >>> MeanAction()(state)["action"]
        tensor([ 0.5000, -2.0000])
    """

    exact = False

    def mixture(self) -> ContinuousMixture:
        """The corner of the mean."""
        return ContinuousMixture(mean=1.0)
