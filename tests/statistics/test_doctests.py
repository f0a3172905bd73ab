"""The examples in the docstrings run and show what they say."""

import doctest
import importlib
import pkgutil

import pytest

import trl_explore.statistics as package

MODULES = [m.name for m in pkgutil.walk_packages(package.__path__, package.__name__ + ".")]


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0
