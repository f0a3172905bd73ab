"""Whatever the configuration offers has a word for readers."""

from __future__ import annotations

import pytest
import yaml

from trl_explore.config import CONF
from trl_explore.names import EXPERIMENTS, OPTIONS, STRATEGIES, option_of, strategy_label
from trl_explore.report.style import KNOWN, styles


def names(group: str) -> list[str]:
    return sorted(path.stem for path in (CONF / group).glob("*.yaml"))


def test_every_strategy_has_a_label_and_a_look():
    assert set(STRATEGIES) == set(names("strategy"))
    assert len({strategy_label(name) for name in STRATEGIES}) == len(STRATEGIES)
    looks = styles(list(STRATEGIES))
    assert len({(look.marker, look.line) for look in looks}) == len(STRATEGIES)
    assert set(KNOWN) <= set(STRATEGIES)


@pytest.mark.parametrize("group", OPTIONS)
def test_every_option_has_a_label(group):
    classes = set()
    for name in names(group):
        config = yaml.safe_load((CONF / group / f"{name}.yaml").read_text(encoding="utf-8"))
        classes.add(config["_target_"].rsplit(".", 1)[-1])
    assert classes <= set(OPTIONS[group])


def test_every_experiment_has_a_title():
    assert set(EXPERIMENTS) == set(names("experiment"))


def test_without_a_choice_the_option_is_that_of_the_thesis():
    assert option_of({}, "correction") == "NoCorrection"
    assert option_of({"correction": {"_target_": "a.b.PerStep"}}, "correction") == "PerStep"
