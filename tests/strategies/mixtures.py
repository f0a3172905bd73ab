"""Preferences and expected probabilities for the tests of mixtures."""

import torch

NEVER = -torch.inf
PREFERENCES = torch.tensor([0.0, 4.0, -1.0, 4.0], dtype=torch.float64)


def close(probs, expected, **tolerance):
    torch.testing.assert_close(probs, torch.tensor(expected, dtype=probs.dtype), **tolerance)
