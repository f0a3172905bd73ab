"""The sentences of the report that depend on how the trials were run."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from trl_explore.report import prose


@pytest.mark.parametrize(
    ("per_update", "words"),
    [
        ([{}], "one episode"),
        ([{"episodes_per_update": 4}, {"episodes_per_update": 4}], "4 episodes"),
        ([{"episodes_per_update": 4}, {}], "one episode or 4 episodes"),
    ],
)
def test_an_iteration_is_as_many_episodes_as_were_run(per_update, words):
    group = SimpleNamespace(environment="E", window=10, threshold=3.0, cap=5, crossed=None)
    outcomes = [SimpleNamespace(strategy="softmax", config=config) for config in per_update]
    evidence: Any = SimpleNamespace(groups=[SimpleNamespace(group=group)], outcomes=outcomes)
    assert f"<b>iteration</b> is {words} and the update that follows." in prose.question(evidence)
