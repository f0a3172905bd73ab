"""Collectors: whole episodes of every active trial, parameters fixed."""

from trl_explore.collectors.auto import auto_collector
from trl_explore.collectors.base import EpisodeCollector
from trl_explore.collectors.fused import FusedCollector, NotCompilable
from trl_explore.collectors.torchrl import TorchRLCollector

__all__ = [
    "EpisodeCollector",
    "FusedCollector",
    "NotCompilable",
    "TorchRLCollector",
    "auto_collector",
]
