"""The collectors, each of which must satisfy the contract; a new one joins the list."""

from __future__ import annotations

import pytest


@pytest.fixture(params=["TorchRLCollector", "SteppingCollector", "FusedCollector"])
def kind(request: pytest.FixtureRequest):
    """The class of a collector."""
    from trl_explore import collectors

    return getattr(collectors, request.param)
