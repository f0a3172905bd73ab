"""OmegaConf's nodes, copied, read and written with less work, and with the same result.

A job is copied several times on its way through Hydra, and most of the time of a copy is spent on
the metadata of each node. An interpolation is parsed again at every access. Most
lines of a job's YAML files are those of the job before it.
"""

from __future__ import annotations

from collections import defaultdict
from copy import deepcopy
from functools import cache, lru_cache
from typing import Any, cast

import yaml
from omegaconf import AnyNode, DictConfig, OmegaConf, base
from omegaconf._utils import get_omega_conf_dumper
from omegaconf.base import ContainerMetadata, Metadata

PARSED = 256
"""Most interpolations whose parse tree is kept."""
WRITTEN = 1000
"""Most values whose YAML text is kept."""
DIVIDED = ("hydra", "job", "runtime")
"""The mappings whose values are kept one by one: few of them differ between the jobs of a sweep."""
_texts: dict[tuple[tuple[str, ...], str, str], str] = {}
"""The YAML text of a value, by the keys above it, and the ``repr`` of its own key and of itself."""


@cache
def speed_up_omegaconf() -> None:
    """Change OmegaConf in this process. Only the command that runs sweeps does so."""
    base.parse = lru_cache(PARSED)(base.parse)  # pyright: ignore[reportPrivateImportUsage]
    for kind in (Metadata, ContainerMetadata):
        kind.__deepcopy__ = _copied  # pyright: ignore[reportAttributeAccessIssue]
    DictConfig.__deepcopy__ = _copied_mapping
    AnyNode.__deepcopy__ = _copied_value


def _copied(metadata: Metadata, memo: dict[int, Any]) -> Metadata:
    """A deep copy of the metadata of a node: only its two dictionaries can change."""
    copy = object.__new__(type(metadata))
    vars(copy).update(vars(metadata))
    copy.flags = None if metadata.flags is None else dict(metadata.flags)
    kept = metadata.resolver_cache
    copy.resolver_cache = deepcopy(kept, memo) if kept else defaultdict(dict)
    return copy


def _copied_mapping(self: DictConfig, memo: dict[int, Any]) -> DictConfig:
    """A deep copy of a mapping; as in OmegaConf, it keeps the parent and does not copy it."""
    copy, old = object.__new__(type(self)), vars(self)
    content = old["_content"]
    if isinstance(content, dict):
        content = {key: deepcopy(child, memo) for key, child in content.items()}
        for child in content.values():
            vars(child)["_parent"] = copy
    metadata = deepcopy(old["_metadata"], memo)
    vars(copy).update(old, _metadata=metadata, _content=content, _flags_cache=None)
    return copy


def _copied_value(self: AnyNode, memo: dict[int, Any]) -> AnyNode:
    """A copy of a leaf, with the same value."""
    copy, old = object.__new__(type(self)), vars(self)
    vars(copy).update(old, _metadata=deepcopy(old["_metadata"], memo), _flags_cache=None)
    return copy


def to_yaml(config: DictConfig) -> str:
    """The text that ``OmegaConf.to_yaml`` gives."""
    plain = OmegaConf.to_container(config, enum_to_str=True)
    text = _block(cast(dict[str, Any], plain), ()) if isinstance(plain, dict) else ""
    return text or OmegaConf.to_yaml(config)


def _block(plain: dict[str, Any], above: tuple[str, ...]) -> str:
    text = ""
    for name, value in plain.items():
        if name in DIVIDED and isinstance(value, dict) and value:
            inner = cast(dict[str, Any], value)
            text += f"{'  ' * len(above)}{name}:\n{_block(inner, (*above, name))}"
            continue
        key = above, repr(name), repr(value)
        if key not in _texts:
            if len(_texts) >= WRITTEN:
                _texts.clear()
            node = {name: value}
            for outer in reversed(above):
                node = {outer: node}
            lines = yaml.dump(
                node, default_flow_style=False, allow_unicode=True, sort_keys=False,
                Dumper=get_omega_conf_dumper(),
            ).splitlines(keepends=True)  # fmt: skip
            _texts[key] = "".join(lines[len(above) :])
        text += _texts[key]
    return text
