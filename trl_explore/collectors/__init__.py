"""Collectors: whole episodes of every active trial, with fixed parameters."""

from trl_explore.collectors.auto import auto_collector
from trl_explore.collectors.collector import EpisodeCollector, Rollout
from trl_explore.collectors.compiling import NotCompilableError
from trl_explore.collectors.fused import FusedCollector
from trl_explore.collectors.stepping import SteppingCollector
from trl_explore.collectors.torchrl import TorchRLCollector

__all__ = [
    "EpisodeCollector",
    "FusedCollector",
    "NotCompilableError",
    "Rollout",
    "SteppingCollector",
    "TorchRLCollector",
    "auto_collector",
]
