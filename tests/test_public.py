"""The names of the package itself, which are imported when they are first used."""

from __future__ import annotations

import subprocess
import sys

import pytest

import trl_explore


@pytest.mark.parametrize("name", trl_explore.__all__)
def test_every_public_name_is_there(name):
    assert getattr(trl_explore, name).__name__ == name
    assert name in dir(trl_explore)


def test_a_name_that_does_not_exist():
    with pytest.raises(AttributeError, match="has no attribute 'EpsilonGreed'"):
        _ = trl_explore.EpsilonGreed  # pyright: ignore[reportAttributeAccessIssue]


def test_the_package_is_imported_without_its_rooms():
    program = "import sys, trl_explore; print(*(set(sys.modules) & {'torch', 'numpy', 'numba'}))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "\n"
