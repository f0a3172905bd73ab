"""The digests of the code that computed a result."""

from __future__ import annotations

import ast
import sys

import pytest

from trl_explore.jobs import code
from trl_explore.jobs.code import changed_code, code_digests


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A module of the user's, and a package."""
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "mine_env.py").write_text("A = 1\n")
    (tmp_path / "mine_package").mkdir()
    for name in ("__init__", "part"):
        (tmp_path / "mine_package" / f"{name}.py").write_text("B = 1\n")
    return tmp_path


CONFIG = {
    "strategy": {"_target_": "mine_package.Mine", "inner": [{"_target_": "torch.nn.Linear"}]},
    "env": {"_target_": "trl_explore.envs.make_env", "id": "mine_env:Mine-v0"},
}


def digests(config):
    code._digest.cache_clear()
    return code_digests(config)


def test_everything_that_computing_code_imports_is_in_the_digest():
    """And everything that a job is built from; checks of values change no result."""
    files = [path for place in code.COMPUTING for path in code._sources(code.ROOT / place)]
    known = {path.relative_to(code.ROOT.parent).with_suffix("").as_posix() for path in files}
    imported = {
        name
        for path in [*files, code.ROOT / "config" / "building.py"]
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("trl_explore")
        for name in _modules_of(node)
    }
    others = {name for name in imported - known if not name.startswith("trl_explore/config/")}
    assert others == {"trl_explore/checks"}


def _modules_of(node):
    """The modules that ``from package import name`` takes, which may be names of modules."""
    place = node.module.replace(".", "/")
    for alias in node.names:
        for found in (f"{place}/{alias.name}", place, f"{place}/__init__"):
            if (code.ROOT.parent / found).with_suffix(".py").is_file():
                yield found
                break


def test_the_modules_of_the_user_are_those_that_the_configuration_names(mine):
    assert list(digests(CONFIG)) == ["trl_explore", "mine_env", "mine_package"]
    assert list(digests({"env": {"id": "CartPole-v1"}})) == ["trl_explore"]
    assert "mine_env" not in sys.modules  # it is not imported


@pytest.mark.parametrize("name", ["mine_env.py", "mine_package/part.py"])
def test_a_changed_file_changes_the_digest_of_its_module_alone(mine, name):
    before = digests(CONFIG)
    assert changed_code(before, digests(CONFIG)) == []
    (mine / name).write_text("C = 2\n")
    (line,) = changed_code(before, digests(CONFIG))
    assert name.partition(".")[0].partition("/")[0] in line


def test_the_code_of_this_package_counts_for_unfinished_jobs_only():
    now = digests({})
    before = {"trl_explore": "another"}
    assert changed_code(before, now)
    assert changed_code(before, now, own=False) == []
    assert changed_code({}, now) == []  # results that recorded no code


def test_a_module_that_only_one_run_names_has_changed():
    before = {"trl_explore": "1", "mine": "2"}
    assert changed_code(before, {"trl_explore": "1"}) == ["code of mine has changed"]
    assert changed_code({"trl_explore": "1"}, before) == ["code of mine has changed"]
    assert changed_code({}, before) == []  # results of older versions have no digests
