"""The configuration files, their defaults, and the error for a wrong configuration."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

_PACKAGE = Path(__file__).resolve().parents[1]
CONF = next(p for p in (_PACKAGE / "conf", _PACKAGE.parent / "conf") if p.is_dir())
"""The folder of the configuration files: inside an installed package, next to it in a checkout."""
_folders = [CONF]
"""The folders that are searched for a file, the user's own (``--config-dir``) first."""
GROUPS = (
    "env", "policy", "strategy", "loss", "correction", "baseline", "optimizer", "collector",
)  # fmt: skip
SCHEDULE = "schedule@"
"""Prefix of a choice that gives a parameter a schedule from ``conf/schedule``:
``+schedule@strategy.temperature=linear``."""
INERT = (
    "output_dir", "restart", "threads", "episodes", "env.workers", "checkpoint_seconds", "debug",
    "keep_weights",
)  # fmt: skip
"""Keys that do not change results; they are not part of a job's name or identity."""
STRATEGY = "strategy@"
"""Prefix of a choice that gives a part a strategy from ``conf/strategy``, as in
``correction=as_if strategy@correction.strategy=argmax``."""


class ConfigError(ValueError):
    """A configuration that cannot be run; the message is one line."""


def check_folder(folder: Path) -> None:
    """Raise a ``ConfigError`` if the folder of ``--config-dir`` is missing or cannot be read."""
    if not folder.is_dir():
        raise ConfigError(f"--config-dir {folder}: no such folder")
    if not os.access(folder, os.R_OK | os.X_OK):
        raise ConfigError(f"--config-dir {folder}: no permission to read it")


def search_in(folders: Iterable[Path]) -> None:
    """Search these folders for configuration files, in this order, and then ``conf/``."""
    wanted = [*dict.fromkeys([*(path.resolve() for path in folders), CONF])]
    if wanted != _folders:
        _folders[:] = wanted
        for cached in (load, group_defaults, _defaults):
            cached.cache_clear()


def files_of(group: str) -> dict[str, Path]:
    """The files of a group by name; a user's own file replaces that of ``conf/``."""
    found = (path for folder in reversed(_folders) for path in (folder / group).glob("*.yaml"))
    return {path.stem: path for path in sorted(found, key=lambda path: path.stem)}


def defaults_of(choices: Mapping[str, str | None]) -> DictConfig:
    """The values in ``conf/`` for these choices, before any override. Do not modify."""
    return _defaults(tuple(sorted(choices.items())))


@lru_cache(maxsize=64)
def _defaults(items: tuple[tuple[str, str | None], ...]) -> DictConfig:
    choices = dict(items)
    defaults = load("train").copy()
    for group in GROUPS:
        defaults[group] = group_defaults(group, choices.get(group)).copy()
    for key, option in strategies_of(choices).items():
        OmegaConf.update(defaults, key, load(f"strategy/{option}"), merge=False)
    defaults = OmegaConf.merge(defaults, load(f"experiment/{choices.get('experiment')}"))
    assert isinstance(defaults, DictConfig)
    for key in ("defaults", "hydra"):
        defaults.pop(key, None)
    for key, option in schedules_of(choices).items():
        if (schedule := load(f"schedule/{option}")) and OmegaConf.select(defaults, key) is not None:
            OmegaConf.update(defaults, key, schedule, merge=False)
    return defaults


@cache
def group_defaults(group: str, option: str | None) -> DictConfig:
    """The values of a group: those of ``train.yaml``, then the file's own. Do not modify."""
    shared, own = load("train").get(group), load(f"{group}/{option}")
    merged = OmegaConf.merge(shared, own) if isinstance(shared, DictConfig) else own.copy()
    assert isinstance(merged, DictConfig)
    merged.pop("defaults", None)
    return merged


@cache
def load(name: str) -> DictConfig:
    """A configuration file, named without extension; empty if there is none. Do not modify."""
    paths = [path for folder in _folders if (path := folder / f"{name}.yaml").is_file()]
    content = OmegaConf.load(paths[0]) if paths else OmegaConf.create()
    assert isinstance(content, DictConfig)
    return content


def alike(key: str) -> str:
    """``; did you mean …?`` for a mistyped key or group, or empty.

    Example:
        >>> alike("lr"), alike("stategy"), alike("xyzzy")
        ('; did you mean optimizer.lr?', '; did you mean strategy?', '')
    """
    known = {str(name): 1.0 for name in load("train") if name not in ("defaults", "hydra")}
    known |= dict.fromkeys(GROUPS, 1.0)
    for group in GROUPS:
        options = [group_defaults(group, option) for option in files_of(group)]
        for name in (f"{group}.{name}" for option in options for name in option):
            known[name] = known.get(name, 0.0) + 1 / len(options)
    last = key.rpartition(".")[2]
    same = [(-share, name) for name, share in known.items() if name.rpartition(".")[2] == last]
    near = get_close_matches(key, known, 1, 0.75)
    found = [min(same)[1]] if same else near
    return f"; did you mean {found[0]}?" if found and found[0] != key else ""


def schedules_of(choices: Mapping[str, str | None]) -> dict[str, str]:
    """The parameters that have a schedule, each with its file in ``conf/schedule``."""
    return _files_of(choices, SCHEDULE)


def strategies_of(choices: Mapping[str, str | None]) -> dict[str, str]:
    """The parts that have a strategy of their own, each with its file in ``conf/strategy``."""
    return _files_of(choices, STRATEGY)


def _files_of(choices: Mapping[str, str | None], prefix: str) -> dict[str, str]:
    return {
        key.removeprefix(prefix): str(option)
        for key, option in sorted(choices.items())
        if key.startswith(prefix)
    }


def same(value: Any, default: Any) -> bool:
    """Whether two configuration values are equal; 1 equals 1.0, but not true."""
    return value == default and isinstance(value, bool) == isinstance(default, bool)


def commented(text: str, choices: Mapping[str, str | None]) -> str:
    """The YAML text of a configuration, with the comments that ``conf/`` has for its keys."""
    names = {"": "train"} | {f"{group}.": f"{group}/{choices.get(group)}" for group in GROUPS}
    found = {p + key: note for p, name in names.items() for key, note in _notes(name).items()}
    out: list[str] = []
    for key, line in _keys(text):
        above, after = found.get(key, ([], ""))
        indent = line[: len(line) - len(line.lstrip())]
        out += [indent + comment for comment in above]
        out.append(f"{line}   {after}" if after else line)
    return "\n".join(out)


def _notes(name: str) -> dict[str, tuple[list[str], str]]:
    """The comments of a file in ``conf/``: key -> lines above it, and the text after it."""
    path = next((p for folder in _folders if (p := folder / f"{name}.yaml").is_file()), None)
    notes: dict[str, tuple[list[str], str]] = {}
    above, last = list[str](), ""
    for key, line in _keys(path.read_text(encoding="utf-8")) if path else ():
        comment = line.strip()
        if comment.startswith("#") and last and line.index("#") > 20:  # goes on from the line above
            notes[last] = notes[last][0], f"{notes[last][1]} {comment.lstrip('# ')}"
        elif comment.startswith("#"):
            above.append(comment)
        else:
            if key:
                after = re.search(r"\s(# .*)", line)
                notes[key] = above, after[1] if after else ""
            above, last = [], key
    return notes


def _keys(text: str) -> Iterator[tuple[str, str]]:
    """Every line of a YAML text with the key that it sets; empty if it sets none."""
    path: list[str] = []
    for line in text.splitlines():
        found = re.match(r"((?:  )*)([\w.]+):", line)
        if found:
            path[len(found[1]) // 2 :] = [found[2]]
        yield ".".join(path) if found else "", line
