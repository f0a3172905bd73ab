"""Compiled arithmetic; operations call it through ``numerics.dispatch``. See ``numerics``."""
