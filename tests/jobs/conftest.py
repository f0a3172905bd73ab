"""A finished job in a folder of its own."""

from pathlib import Path

import pytest

from tests.jobs.written import write


@pytest.fixture
def job(tmp_path) -> Path:
    return write(tmp_path / "thesis" / "epsilon_greedy,epsilon=0.1")
