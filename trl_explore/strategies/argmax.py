"""Full exploitation."""

from __future__ import annotations

from trl_explore.strategies.mixture import Mixture, MixtureStrategy


class Argmax(MixtureStrategy):
    """The action that the policy prefers; ties share.

    μ(a|s) = 1[a ∈ A*] / |A*|,   A* = argmax_a logits_a      (thesis, §2.2.2)

    Example:
        >>> import torch
        >>> Argmax().probs(torch.tensor([0.0, 4.0, -1.0, 4.0]))
        tensor([0.0000, 0.5000, 0.0000, 0.5000])
    """

    def mixture(self) -> Mixture:
        """The greedy corner."""
        return Mixture(greedy=1.0)
