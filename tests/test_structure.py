"""The structure of the package: rooms in one order, imports that point down, no circles."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
NAME = "trl_explore"
PACKAGE = ROOT / NAME

ROOMS = (
    "checks",
    "names",
    "numerics",
    "statistics",
    "strategies",
    "envs",
    "policies",
    "objectives",
    "collectors",
    "training",
    "jobs",
    "logs",
    "config",
    "thesis",
    "report",
    "show",
    "commands",
)
"""From the bottom up: a module imports from its own room and from those before it."""

USERS = {
    "numba": ("numerics", "envs.kernels", "collectors", "training.optimizers"),
    "llvmlite": ("numerics",),
    "hydra": ("config", "commands"),
    "omegaconf": ("config", "commands"),
    "matplotlib": ("report", "show"),
    "jinja2": ("report", "show"),
    f"{NAME}.thesis": ("thesis", "report"),
}
"""The only parts of the package that may import each of these, anywhere in their modules."""

TORCH = {"torch", "tensordict", "torchrl"}
WITHOUT_TORCH = ("statistics", "logs", "thesis", "report")
HEAVY = TORCH | {"hydra", "omegaconf", "numba", "llvmlite"}
"""What importing the rooms without torch must not import, directly or through others."""

KNOWN = (
    # The mark of a compiled kernel is defined in the room of the kernels.
    ("numerics", "envs.kernels.kernel"),
)
"""Imports that break a rule today: the importing module or room, and what it imports."""


TESTS_OF_OTHERS = {Path(), Path("benchmarks"), Path("commands")}
"""Folders of tests that need no room: the tests of the whole, of benchmarks/ and of scripts/."""


class Import(NamedTuple):
    """One import statement: what it imports, in which line, and whether a function defers it."""

    name: str
    line: int
    deferred: bool


def modules() -> dict[str, Path]:
    """The file of every module of the package; a package is named like its folder."""
    found = {}
    for file in PACKAGE.rglob("*.py"):
        parts = file.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


MODULES = modules()


def read_imports(tree: ast.AST, deferred: bool = False) -> Iterator[Import]:
    """Every import below ``tree``; those under ``TYPE_CHECKING`` are deferred too."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, node.lineno, deferred) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: a relative import"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                if full == f"{NAME}.__version__":
                    continue  # the package itself is imported before each of its modules
                name = full if full in MODULES else str(node.module)
                yield Import(name, node.lineno, deferred)
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            yield from read_imports(ast.Module(node.body, []), True)
            yield from read_imports(ast.Module(node.orelse, []), deferred)
        else:
            function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            yield from read_imports(node, deferred or function)


@cache
def imports(module: str) -> tuple[Import, ...]:
    """The imports of a module of the package."""
    tree = ast.parse(MODULES[module].read_text(encoding="utf-8"))
    return tuple(dict.fromkeys(read_imports(tree)))


def within(module: str, *parts: str) -> bool:
    """Whether ``module`` is one of the modules or packages ``parts``, or is inside one."""
    return any(f"{module}.".startswith(f"{part}.") for part in parts)


def inside(module: str, *parts: str) -> bool:
    """Like ``within``, for parts that are named without the package."""
    return within(module, *(f"{NAME}.{part}" for part in parts))


def known(module: str, name: str) -> bool:
    return any(inside(module, part) and inside(name, imported) for part, imported in KNOWN)


def height(module: str) -> int:
    """The place of a module's room in ``ROOMS``; the package itself is above them all."""
    return len(ROOMS) if module == NAME else ROOMS.index(module.split(".")[1])


def at_import(module: str) -> Iterator[str]:
    """What importing ``module`` imports at once: the packages around it, and what it names."""
    yield from (module.rsplit(".", n)[0] for n in range(1, module.count(".") + 1))
    yield from (found.name for found in imports(module) if not found.deferred)


def test_every_form_of_import_is_read():
    lines = [
        "import torch",
        "from trl_explore import checks",
        "if TYPE_CHECKING:",
        "    from numba import njit",
        "def f():",
        "    from trl_explore.checks import check_number",
    ]
    assert list(read_imports(ast.parse("\n".join(lines)))) == [
        ("torch", 1, False),
        ("trl_explore.checks", 2, False),
        ("numba", 4, True),
        ("trl_explore.checks", 6, True),
    ]


def test_the_package_holds_rooms_and_at_most_two_modules():
    files = {path.stem for path in PACKAGE.glob("*.py")} - {"__init__"}
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert len(files) <= 2
    assert files | folders <= set(ROOMS)
    assert {path.parent.relative_to(PACKAGE).parts[0] for path in PACKAGE.glob("*/**/*.py")} == (
        folders
    )


def test_no_module_is_named_for_nothing():
    vague = {"base", "common", "helpers", "misc", "util", "utils"}
    assert {name for name in MODULES if name.rsplit(".", 1)[-1] in vague} == set()


def test_imports_point_down():
    upward = [
        f"{module}:{found.line} imports {found.name}"
        for module in MODULES
        for found in imports(module)
        if within(found.name, NAME) and height(found.name) > height(module)
        if not known(module, found.name)
    ]
    assert not upward, upward


def test_there_are_no_circles():
    """Also not among the modules of one room, nor through an import in a function."""
    graph = {
        module: {found.name for found in imports(module) if found.name in MODULES}
        for module in MODULES
    }
    assert len(list(TopologicalSorter(graph).static_order())) == len(MODULES)


@pytest.mark.parametrize("name", USERS)
def test_who_may_import(name):
    others = [
        f"{module}:{found.line}"
        for module in MODULES
        for found in imports(module)
        if within(found.name, name) and not inside(module, *USERS[name])
        if not known(module, found.name)
    ]
    assert not others, others


@pytest.mark.parametrize("room", WITHOUT_TORCH)
def test_rooms_without_torch(room):
    """No module of the room names torch, and nothing that it imports does so at import."""
    waiting = [module for module in MODULES if inside(module, room)]
    direct = [m for m in waiting for found in imports(m) if found.name.split(".")[0] in TORCH]
    assert not direct, direct
    chain = dict.fromkeys(waiting, "")
    while waiting:
        module = waiting.pop()
        for name in at_import(module):
            way = f"{chain[module]} {module}"
            assert name.split(".")[0] not in HEAVY, f"{way} imports {name}"
            if name in MODULES and name not in chain:
                chain[name] = way
                waiting.append(name)


def test_rooms_without_torch_are_imported_without_it():
    names = [name for name in MODULES if inside(name, *WITHOUT_TORCH)]
    program = f"""
import importlib, sys
for name in {names}:
    importlib.import_module(name)
assert not {HEAVY} & set(sys.modules), {HEAVY} & set(sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_tests_mirror_the_rooms():
    tests = {path.parent.relative_to(ROOT / "tests") for path in ROOT.glob("tests/**/test_*.py")}
    rooms = {path.parent.relative_to(PACKAGE) for path in PACKAGE.glob("*/**/__init__.py")}
    assert {room for room in rooms if len(room.parts) == 1} <= tests
    assert tests - rooms <= TESTS_OF_OTHERS


def test_the_page_on_the_architecture_names_files_that_exist():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:[a-z_]+/)+[a-z_]+\.\w+)`", text))
    assert len(named) > 60
    files = {p: next((f for f in (PACKAGE / p, ROOT / p) if f.exists()), None) for p in named}
    assert [p for p, file in sorted(files.items()) if file is None] == []
    parts = re.findall(r"`([A-Za-z_.]+)` in `((?:[a-z_]+/)+[a-z_]+\.\w+)`", text)
    assert len(parts) > 30
    for name, path in parts:
        assert name.split(".")[-1] in files[path].read_text(encoding="utf-8"), (name, path)
