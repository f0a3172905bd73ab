"""Docstrings name every argument, and no other, in the rooms that other programs import."""

import importlib
import inspect
import pkgutil
import re

from trl_explore.strategies.schedules import Cosine, Linear

ROOMS = ("strategies", "objectives", "policies")
OWN = "trl_explore"


def modules():
    for room in ROOMS:
        package = importlib.import_module(f"{OWN}.{room}")
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            yield importlib.import_module(found.name)


def documented():
    """Every public class with a constructor of its own, public function and public method."""
    for module in modules():
        for name, thing in vars(module).items():
            if name.startswith("_") or getattr(thing, "__module__", "") != module.__name__:
                continue
            if inspect.isfunction(thing):
                yield f"{module.__name__}.{name}", thing, thing.__doc__
            elif inspect.isclass(thing):
                yield from of_class(thing)


def of_class(kind):
    path = f"{kind.__module__}.{kind.__name__}"
    if "__init__" in vars(kind):
        yield path, kind.__init__, kind.__doc__
    for name, method in vars(kind).items():
        if not name.startswith("_") and inspect.isfunction(method):
            yield f"{path}.{name}", method, method.__doc__


def arguments(doc):
    """The names under Args and Keyword Args, in order."""
    names, section = [], ""
    for line in inspect.cleandoc(doc).splitlines():
        if line and not line.startswith(" "):
            section = line
        elif section in ("Args:", "Keyword Args:") and (m := re.match(r"    \*{0,2}(\w+):", line)):
            names.append(m.group(1))
    return names


def test_args_are_those_of_the_signature():
    for where, function, doc in documented():
        names = [name for name in inspect.signature(function).parameters if name != "self"]
        found = arguments(doc or "")
        if found or function.__name__ == "__init__":
            assert found == names, where


def test_the_check_reads_every_section():
    doc = """One.

    Args:
        a: first
            a: not a name.
        b: second.

    Keyword Args:
        c: third.

    Raises:
        ValueError: never.
    """
    assert arguments(doc) == ["a", "b", "c"]
    assert arguments(Linear.__doc__) == [*inspect.signature(Linear).parameters]
    assert inspect.signature(Cosine) == inspect.signature(Linear)
