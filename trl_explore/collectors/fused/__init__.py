"""The fused collector: environment, policy and strategy in one compiled loop over episodes."""

from trl_explore.collectors.fused.collector import FusedCollector

__all__ = ["FusedCollector"]
