"""The stepping collector: any environment, and one compiled call per step for all lanes."""
