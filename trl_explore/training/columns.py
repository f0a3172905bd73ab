"""The names of the quantities that the training records; imports nothing, so that readers can."""

from __future__ import annotations

DIAGNOSTIC_COLUMNS = (
    "entropy_policy", "entropy_behaviour", "kl", "ratio_mean", "effective_sample_size",
    "exploratory", "greedy_share", "coverage", "gradient_norm",
)  # fmt: skip
