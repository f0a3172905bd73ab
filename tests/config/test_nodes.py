"""OmegaConf with less work: copies and parsed interpolations are what they were."""

from copy import deepcopy
from typing import Any, cast

import pytest
from omegaconf import OmegaConf, base
from omegaconf.errors import GrammarParseError, ReadonlyConfigError

from tests.config.composed import composed
from trl_explore.config.nodes import save_work

pytestmark = pytest.mark.usefixtures("hydra")

TEXT = """
a: {b: 1, c: "${a.b}", list: [1, "${a.b}", null], empty: {}}
d: "${a}"
"""


def test_a_copy_is_equal_in_all_that_a_node_knows_and_shares_nothing():
    save_work()
    for config in (cast(Any, OmegaConf.create(TEXT)), composed("strategy=epsilon_greedy")[0]):
        first = str(next(iter(config)))
        OmegaConf.set_readonly(config, True)
        copy = deepcopy(config)
        assert copy == config
        assert OmegaConf.to_yaml(copy) == OmegaConf.to_yaml(config)
        for name in ["", *(str(key) for key in config)]:
            old, new = (x._get_node(name) if name else x for x in (config, copy))
            assert vars(old._metadata) == vars(new._metadata)
            assert type(old._metadata) is type(new._metadata)
            assert old._metadata is not new._metadata
            assert old._metadata.flags is not new._metadata.flags
            assert old._metadata.resolver_cache is not new._metadata.resolver_cache
        OmegaConf.set_readonly(copy, False)
        copy[first] = 7
        assert copy[first] == 7 != config[first]
        with pytest.raises(ReadonlyConfigError):
            config[first] = 7


def test_a_kept_parse_tree_gives_the_value_of_now_and_of_its_own_place():
    save_work()
    one, other = (cast(Any, OmegaConf.create(TEXT)) for _ in range(2))
    assert one.a.c == other.a.c == 1
    one.a.b = 2
    assert (one.a.c, one.a.list[1], one.d.c, other.a.c) == (2, 2, 2, 1)
    parse = vars(base)["parse"]
    assert parse("${a.b}") is parse("${a.b}")
    for _ in range(2):  # an error is not kept, and not lost
        with pytest.raises(GrammarParseError):
            parse("${a.b")
