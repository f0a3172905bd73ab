"""The fused collector: environment, policy and strategy in one compiled loop over episodes."""
