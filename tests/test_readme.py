"""The README's Python runs as it stands there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import torch

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_a_strategy_and_the_loss_in_a_project_of_ones_own():
    scope: dict[str, Any] = {}
    exec(BLOCKS[0] + BLOCKS[1], scope)
    data = scope["data"]
    assert (data["action_log_prob"].exp() >= 0.05 - 1e-6).all()  # epsilon 0.1 over two actions
    assert scope["logits"].module.weight.grad.abs().sum() > 0


def test_a_strategy_of_ones_own():
    scope: dict[str, Any] = {}
    exec(BLOCKS[2], scope)
    probs = scope["MaxBoltzmann"](epsilon=0.5).probs(torch.tensor([0.0, 0.0, 2.0]))
    soft = torch.tensor([0.0, 0.0, 2.0]).softmax(-1)
    torch.testing.assert_close(probs, 0.5 * soft + 0.5 * torch.tensor([0.0, 0.0, 1.0]))
