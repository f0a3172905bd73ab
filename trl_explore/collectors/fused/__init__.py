"""The fused collector: environment, policy and strategy as one compiled loop over episodes."""

from trl_explore.collectors.fused.collector import FusedCollector, NotCompilableError

__all__ = ["FusedCollector", "NotCompilableError"]
