"""What the README and the pages of docs/ show runs as it stands there."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch

ROOT = Path(__file__).resolve().parents[1]
COMMAND = ROOT / "tests" / "command.py"
SMALL = ["trials=2", "max_iterations=6", "score_window=3", "score_threshold=15", "threads=1"]
"""What makes a run short; trials only where their number does not matter."""
ELSEWHERE = ("hydra/launcher=", "--help", "hydra.launcher", "study.yaml", "--from ", " settle ",
             " tune ")  # fmt: skip
"""Commands that other tests run: in tests/config, tests/commands and tests/report."""


class Block(NamedTuple):
    """A block of code in a page."""

    language: str
    text: str


def blocks(page: Path) -> list[Block]:
    found = re.findall(r"^```(\w+)\n(.*?)^```", page.read_text("utf-8"), re.DOTALL | re.MULTILINE)
    return [Block(*block) for block in found]


def file_of(block: Block) -> str | None:
    """The name of the file that a block shows, in a comment in its first lines."""
    name = re.match(r"(?:# @.*\n)?# ([\w/]+\.(?:py|yaml))\n", block.text)
    return name[1] if name else None


def commands(block: Block) -> list[list[str]]:
    """The commands of a block that are run here, each made small."""
    found = []
    for line in block.text.splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] != ["trl-explore"] or any(mark in line for mark in ELSEWHERE):
            continue
        if words[1] == "train":
            fixed = "first_trial" in line or "trials=3" in words
            words += [word for word in SMALL if not (fixed and word.startswith("trials"))]
        found.append(words[1:])
    return found


PAGES = ["README", "docs/tutorial", "docs/own_strategy", "docs/own_environment", "docs/own_study",
         "docs/results", "docs/bias", "docs/torchrl"]  # fmt: skip


@pytest.mark.parametrize("page", PAGES)
def test_a_page_runs_from_top_to_bottom(page, run_many, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    scope: dict[str, Any] = {}
    for block in blocks(ROOT / f"{page}.md"):
        name = file_of(block)
        if name is not None:
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(block.text, encoding="utf-8")
        elif block.language == "python":
            exec(block.text, scope)
        elif block.language == "sh":
            words = commands(block)
            for done, command in zip(run_many(words, tmp_path, COMMAND), words, strict=True):
                assert done.returncode == 0, f"{' '.join(command)}: {done.stderr}"
    for module in [m for m in sys.modules if (tmp_path / f"{m}.py").is_file()]:
        del sys.modules[module]


def test_every_page_with_code_is_run():
    with_code = {
        str(page.relative_to(ROOT).with_suffix(""))
        for page in [ROOT / "README.md", *ROOT.glob("docs/*.md")]
        if any(block.language == "python" for block in blocks(page))
    }
    assert with_code - {"docs/own_kernel"} <= set(PAGES)  # that one: tests/envs


def test_the_readme_explores_and_learns():
    """With ε = 0.1 over two actions, each has a probability of at least 0.05."""
    scope: dict[str, Any] = {}
    for block in blocks(ROOT / "README.md"):
        if block.language == "python":
            exec(block.text, scope)
    assert (scope["data"]["action_log_prob"].exp() >= 0.05 - 1e-6).all()
    assert scope["logits"].module.weight.grad.abs().sum() > 0


def test_a_strategy_of_ones_own():
    scope: dict[str, Any] = {}
    exec(blocks(ROOT / "docs/own_strategy.md")[0].text, scope)
    strategy, logits = scope["EpsilonFirst"](iterations=1), torch.tensor([0.0, 0.0, 2.0])
    torch.testing.assert_close(strategy.probs(logits), torch.full((3,), 1 / 3))
    strategy.step()
    torch.testing.assert_close(strategy.probs(logits), logits.softmax(-1))
    # As test_parameters_per_trial asks of every strategy: what cannot be a list refuses one.
    with pytest.raises(ValueError, match=r"^iterations.*\[20, 10\]"):
        scope["EpsilonFirst"](iterations=[20, 10])
    # And from the first iteration on it must be seen for how many trials there are values.
    assert np.shape(scope["EpsilonFirst"](temperature=[1, 2, 4]).mixture().temperature) == (3,)


def test_the_page_for_torchrl_programs_names_every_strategy():
    page = (ROOT / "docs" / "torchrl.md").read_text(encoding="utf-8")
    files = (ROOT / "conf" / "strategy").glob("*.yaml")
    targets = [re.search(r"_target_: [\w.]+\.(\w+)", file.read_text("utf-8")) for file in files]
    assert {target[1] for target in targets if target} <= set(re.findall(r"`(\w+)`", page))


@pytest.mark.parametrize("group", ["strategy", "correction", "baseline", "policy", "env"])
def test_the_page_of_options_names_every_file(group):
    page = (ROOT / "docs" / "options.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([a-z0-9_]+)(?: [^`]*)?`", page))
    files = {path.stem for path in (ROOT / "conf" / group).glob("*.yaml")}
    assert files <= named, files - named
