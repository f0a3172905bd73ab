"""Collectors: whole episodes of every active trial, parameters fixed."""

from trl_explore.collectors.base import EpisodeCollector
from trl_explore.collectors.torchrl import TorchRLCollector

__all__ = ["EpisodeCollector", "TorchRLCollector"]
