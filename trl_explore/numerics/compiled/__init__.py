"""Compiled arithmetic. Operations reach it through ``numerics.dispatch``; see ``numerics``."""
