"""Full exploration."""

from __future__ import annotations

from trl_explore.strategies.mixture import Mixture, MixtureStrategy


class Random(MixtureStrategy):
    """Uniform over the actions, whatever the policy prefers.

    μ(a|s) = 1 / n_actions      (thesis, §2.2.1)

    Example:
        >>> import torch
        >>> Random().probs(torch.tensor([0.0, 3.0]))
        tensor([0.5000, 0.5000])
    """

    differentiable = True

    def mixture(self) -> Mixture:
        """The uniform corner."""
        return Mixture(uniform=1.0)
