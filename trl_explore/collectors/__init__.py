"""Collectors: whole episodes of every active trial, with fixed parameters."""

from trl_explore.collectors.auto import auto_collector
from trl_explore.collectors.collector import EpisodeCollector, Rollout
from trl_explore.collectors.compilable import NotCompilableError
from trl_explore.collectors.fused.collector import FusedCollector
from trl_explore.collectors.stepping.collector import SteppingCollector
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
