"""Arithmetic on frames and lanes whose cost per frame is as small as that of a compiled step.

Each operation has one formula, written twice: in torch, for any device, shape and dtype, and
compiled, for flat frames on the CPU. No sum runs over the frames of more than one trial, and
every sum runs in the order of the frames, so that a trial does not depend on its neighbours.
"""

from trl_explore.ops.activation import activate
from trl_explore.ops.exponential import exp32, log1p32, log32
from trl_explore.ops.gaussian import gaussian_entropy, gaussian_log_prob
from trl_explore.ops.linear import lane_linear
from trl_explore.ops.log_prob import categorical_log_prob
from trl_explore.ops.returns import return_to_go
from trl_explore.ops.score import (
    lane_sum,
    linear_softmax_gradient,
    linear_softmax_reinforce,
    linear_softmax_score,
    serves,
)

__all__ = [
    "activate",
    "categorical_log_prob",
    "exp32",
    "gaussian_entropy",
    "gaussian_log_prob",
    "lane_linear",
    "lane_sum",
    "linear_softmax_gradient",
    "linear_softmax_reinforce",
    "linear_softmax_score",
    "log1p32",
    "log32",
    "return_to_go",
    "serves",
]
