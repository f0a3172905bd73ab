"""The Python of the README and of docs/torchrl.md runs as it stands there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_a_strategy_and_the_loss_in_a_project_of_ones_own():
    scope: dict[str, Any] = {}
    exec(BLOCKS[0] + BLOCKS[1], scope)
    data = scope["data"]
    assert (data["action_log_prob"].exp() >= 0.05 - 1e-6).all()  # epsilon 0.1 over two actions
    assert scope["logits"].module.weight.grad.abs().sum() > 0


def test_the_page_for_torchrl_programs():
    page = (Path(__file__).resolve().parents[1] / "docs" / "torchrl.md").read_text(encoding="utf-8")
    scope: dict[str, Any] = {}
    exec("".join(re.findall(r"```python\n(.*?)```", page, re.DOTALL)), scope)
    assert scope["data"]["action_log_prob"].isfinite().all()
    assert scope["network"].module.weight.grad.abs().sum() > 0
    files = (Path(__file__).resolve().parents[1] / "conf" / "strategy").glob("*.yaml")
    targets = [re.search(r"_target_: [\w.]+\.(\w+)", file.read_text("utf-8")) for file in files]
    assert {target[1] for target in targets if target} <= set(re.findall(r"`(\w+)`", page))


def test_a_strategy_of_ones_own():
    scope: dict[str, Any] = {}
    exec(BLOCKS[2], scope)
    strategy, logits = scope["EpsilonFirst"](iterations=1), torch.tensor([0.0, 0.0, 2.0])
    torch.testing.assert_close(strategy.probs(logits), torch.full((3,), 1 / 3))
    strategy.step()
    torch.testing.assert_close(strategy.probs(logits), logits.softmax(-1))
    # As test_parameters_per_trial asks of every strategy: what cannot be a list refuses one.
    with pytest.raises(ValueError, match=r"^iterations.*\[20, 10\]"):
        scope["EpsilonFirst"](iterations=[20, 10])
    # And from the first iteration on it must be seen for how many trials there are values.
    assert np.shape(scope["EpsilonFirst"](temperature=[1, 2, 4]).mixture().temperature) == (3,)


@pytest.mark.parametrize("group", ["strategy", "correction", "baseline", "policy", "env"])
def test_the_page_of_options_names_every_file(group):
    root = Path(__file__).resolve().parents[1]
    page = (root / "docs" / "options.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([a-z0-9_]+)(?: [^`]*)?`", page))
    files = {path.stem for path in (root / "conf" / group).glob("*.yaml")}
    assert files <= named, files - named
