"""OmegaConf with less work: copies and parsed interpolations are what they were."""

from collections.abc import Iterator
from copy import deepcopy
from typing import Any, cast

import pytest
from hydra import compose
from omegaconf import AnyNode, DictConfig, OmegaConf, base, open_dict
from omegaconf.base import ContainerMetadata, Metadata
from omegaconf.errors import GrammarParseError, ReadonlyConfigError

from tests.config.composed import composed
from trl_explore.config.nodes import speed_up_omegaconf, to_yaml

pytestmark = pytest.mark.usefixtures("hydra")

TEXT = """
a: {b: 1, c: "${a.b}", list: [1, "${a.b}", null], empty: {}}
d: "${a}"
"""


@pytest.fixture
def fast() -> Iterator[None]:
    """OmegaConf as the command that runs sweeps changes it; afterwards as it was."""
    kinds = (Metadata, ContainerMetadata, DictConfig, AnyNode)
    before = [vars(kind).get("__deepcopy__") for kind in kinds]
    parse = vars(base)["parse"]
    speed_up_omegaconf.cache_clear()
    speed_up_omegaconf()
    yield
    vars(base)["parse"] = parse
    for kind, method in zip(kinds, before, strict=True):
        if method is None:
            del kind.__deepcopy__
        else:
            kind.__deepcopy__ = method
    speed_up_omegaconf.cache_clear()


@pytest.fixture
def originals() -> list[tuple[Any, Any]]:
    """Configurations, and their copies by OmegaConf itself."""
    made = [cast(Any, OmegaConf.create(TEXT)), composed("strategy=epsilon_greedy")[0]]
    for config in made:
        OmegaConf.set_readonly(config, True)
    return [(config, deepcopy(config)) for config in made]


def test_a_copy_is_that_of_omegaconf(originals, fast):
    def known(node):
        own = vars(node._metadata)
        return type(node), own, node._get_full_key(None)

    for config, slow in originals:
        copy = deepcopy(config)
        names = [str(key) for key in config]
        assert copy == slow
        assert [known(copy._get_node(n)) for n in names] == [
            known(slow._get_node(n)) for n in names
        ]
        assert known(copy) == known(slow)


def test_a_copy_is_equal_in_all_that_a_node_knows_and_shares_nothing(originals, fast):
    for config, _ in originals:
        first = str(next(iter(config)))
        copy = deepcopy(config)
        assert copy == config
        assert OmegaConf.to_yaml(copy) == OmegaConf.to_yaml(config)
        for name in ["", *(str(key) for key in config)]:
            old, new = (x._get_node(name) if name else x for x in (config, copy))
            assert vars(old._metadata) == vars(new._metadata)
            assert vars(old).keys() == vars(new).keys()
            assert new._get_parent() is (copy if name else None)
            assert type(old._metadata) is type(new._metadata)
            assert old._metadata is not new._metadata
            assert old._metadata.flags is not new._metadata.flags
            assert old._metadata.resolver_cache is not new._metadata.resolver_cache
        OmegaConf.set_readonly(copy, False)
        copy[first] = 7
        assert copy[first] == 7 != config[first]
        with pytest.raises(ReadonlyConfigError):
            config[first] = 7


def test_a_kept_parse_tree_gives_the_value_of_now_and_of_its_own_place(fast):
    one, other = (cast(Any, OmegaConf.create(TEXT)) for _ in range(2))
    assert one.a.c == other.a.c == 1
    one.a.b = 2
    assert (one.a.c, one.a.list[1], one.d.c, other.a.c) == (2, 2, 2, 1)
    parse = vars(base)["parse"]
    assert parse("${a.b}") is parse("${a.b}")
    for _ in range(2):  # an error is not kept, and not lost
        with pytest.raises(GrammarParseError):
            parse("${a.b")


ATTRIBUTES = "+env.attributes={a: 1, b: true, c: 1.0, d: null, e: [1, {f: '1'}]}"


@pytest.mark.parametrize(
    "words", [[], ["+env.kwargs.s='ä: x\n#b'", "strategy=mixture"], [ATTRIBUTES]]
)
def test_the_yaml_text_is_that_of_omegaconf_and_depends_on_no_text_before_it(words):
    config = compose("train", overrides=words, return_hydra_config=True)
    with open_dict(config):
        config.hydra.job.num, config.hydra.job.id = 3, "x"
        config.hydra.runtime.output_dir = "/a/" + "long name " * 30
    for node in (config, OmegaConf.masked_copy(config, "hydra"), OmegaConf.create()):
        for _ in range(2):
            assert to_yaml(node) == OmegaConf.to_yaml(node)
    values = [
        "1",
        1,
        1.0,
        True,
        None,
        "yes",
        "",
        [],
        {},
        [[]],
        {"hydra": {"job": 1}},
        "a\nb",
        "é\u2028",
    ]
    for value in values:  # values that are alike follow each other
        for node in ({"a": value}, {"hydra": {"job": value}}, {"job": {"hydra": {"x": value}}}):
            assert to_yaml(OmegaConf.create(node)) == OmegaConf.to_yaml(OmegaConf.create(node))


@pytest.mark.parametrize("keys", [(True, 1), (1, True), (1.0, 1)])
def test_keys_that_are_equal_have_texts_of_their_own(keys):
    for key in keys:
        config = OmegaConf.create({key: "a", "b": {key: 1}})
        assert to_yaml(config) == OmegaConf.to_yaml(config)
