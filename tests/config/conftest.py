from __future__ import annotations

import pytest
from hydra import initialize_config_dir

from trl_explore.config import CONF, register_resolvers


@pytest.fixture(scope="module")
def hydra():
    """Hydra composes from ``conf/`` in this process."""
    register_resolvers()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        yield
