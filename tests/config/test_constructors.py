"""Constructors that a configuration describes."""

from __future__ import annotations

import sys
import threading

from omegaconf import OmegaConf

from trl_explore.config.constructors import constructor_of


class Counting:
    """An object with a state that cannot be copied."""

    def __init__(self):
        self.lock, self.made = threading.Lock(), 0

    def make(self, x):
        self.made += 1
        return x


COUNTING = Counting()


def test_a_constructor_is_looked_up_again_and_is_not_copied(monkeypatch):
    """A notebook defines a class again; a method keeps its object."""
    construct = constructor_of(
        OmegaConf.create({"x": {"_target_": f"{__name__}.COUNTING.make", "x": 0.2}}), "x"
    )
    assert [construct(), construct()] == [0.2, 0.2]
    first, other = COUNTING, Counting()
    monkeypatch.setattr(sys.modules[__name__], "COUNTING", other)
    construct()
    assert (first.made, other.made) == (2, 1)


def test_every_object_has_its_own_arguments():
    construct = constructor_of(
        OmegaConf.create({"x": {"_target_": "builtins.dict", "values": [1, 2]}}), "x"
    )
    one, two = construct(), construct()
    one["values"].append(3)
    assert two == construct() == {"values": [1, 2]}


def test_numbers_of_different_types_are_different_configurations():
    made = [
        constructor_of(OmegaConf.create({"x": {"_target_": "builtins.dict", "v": v}}), "x")()["v"]
        for v in (1, 1.0, True)
    ]
    assert [type(v) for v in made] == [int, float, bool]
