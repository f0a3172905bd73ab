"""The stepping collector: any environment, and one compiled call per step for all lanes."""

from trl_explore.collectors.stepping.collector import SteppingCollector

__all__ = ["SteppingCollector"]
