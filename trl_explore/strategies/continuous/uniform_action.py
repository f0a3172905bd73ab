"""Full exploration of a box of actions."""

from __future__ import annotations

from trl_explore.strategies.continuous.mixture import ContinuousMixture, ContinuousMixtureStrategy


class UniformAction(ContinuousMixtureStrategy):
    """Uniform over the box of the actions, whatever the policy prefers; the counterpart of random.

    μ(a|s) = Π_j 1[low_j ≤ a_j ≤ high_j] / (high_j − low_j)

    Raises:
        ValueError: if the box is not finite.

    Example:
        >>> import torch
        >>> from torchrl.data import Bounded
        >>> uniform = UniformAction(spec=Bounded(-2.0, 2.0, shape=(1,)))
        >>> zero, one = torch.zeros(1), torch.ones(1)
        >>> uniform.log_prob(zero, loc=zero, scale=one).exp()
        tensor(0.2500)
    """

    differentiable = True
    boxed = True

    def mixture(self) -> ContinuousMixture:
        """The uniform corner."""
        return ContinuousMixture(uniform=1.0)
