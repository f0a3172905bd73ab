"""Errors in a configuration, and differences between two, one line each."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any, cast

from hydra._internal.utils import _locate
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, MissingConfigException
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from trl_explore.checks import LARGEST, MAX_THREADS, check_integer, check_number, first_line
from trl_explore.config.files import (
    GROUPS,
    INERT,
    ConfigError,
    alike,
    defaults_of,
    files_of,
    group_defaults,
    load,
    same,
    schedules_of,
    strategies_of,
)

ERRORS = (HydraException, OmegaConfBaseException, ValueError, OSError)
"""The errors of a user, which ``describe`` puts in one line."""
FLAGS = ("--config-name", "-cn", "--config-dir", "-cd", "--config-path", "-cp", "--package", "-p")
"""Flags of Hydra that are followed by a value."""
INTEGERS = {
    "seed": (0, LARGEST),
    "trials": (1, 10**7),
    "first_trial": (0, LARGEST - 10**7),
    "threads": (1, MAX_THREADS),
    "episodes_per_update": (1, 10**6),
    "evaluate_episodes": (1, 10**6),
    "evaluate_confirm": (20, 10**6),
}
"""The top-level keys that hold an integer, and their bounds."""
POLICIES = ("greedy", "sampled")
"""How evaluations play π."""
LIMITED = ("strategy", "policy")
"""The groups whose options support one kind of action, the attribute ``actions`` of the class."""


def check_keys(config: DictConfig, choices: Mapping[str, str | None]) -> None:
    """Reject keys that no file of ``conf/`` has, which Hydra accepts as ``+key=value``.

    Raises:
        ConfigError: if a key is unknown or missing; the message names it and the known keys.
    """
    for name in schedules_of(choices):
        if not re.fullmatch(r"(correction\.)?strategy\.\w+", name):
            raise ConfigError(
                "a schedule must name a parameter of the strategy, "
                f"+schedule@strategy.NAME=…, got {name!r}"
            )
    defaults = defaults_of(choices)
    known = set(defaults)
    for name in config:
        if name not in known:
            hint = alike(str(name)) or f"; known: {', '.join(sorted(known))}"
            raise ConfigError(f"unknown key {name!r}{hint}")
    for name in sorted(known - {str(key) for key in config}):
        raise ConfigError(f"missing key: {name}")
    for name in ("episodes", "restart", "diagnostics", "debug"):
        if not isinstance(config[name], bool):
            raise ConfigError(f"{name} must be true or false, got {config[name]!r}")
    for group in GROUPS:
        _check_group(config, group, choices)
    for name, expected in defaults.strategy.items():
        _check_schedule(config, str(name), expected, choices)


def _check_group(config: DictConfig, group: str, choices: Mapping[str, str | None]) -> None:
    if not isinstance(config[group], DictConfig):
        raise ConfigError(f"{group} must name a file of conf/{group}/, got {config[group]}")
    option = choices.get(group)
    if not load(f"{group}/{option}"):
        return  # the user's own file; the constructor checks its keys
    allowed = {str(key) for key in group_defaults(group, option)}
    parts = strategies_of(choices)
    allowed |= {key.removeprefix(f"{group}.") for key in parts if key.startswith(f"{group}.")}
    given = {str(key) for key in config[group]}
    for name in sorted(given - allowed):
        shown = sorted(key for key in allowed if not key.startswith("_"))
        raise ConfigError(
            f"unknown key '{group}.{name}'; {group}={option} has: {', '.join(shown) or 'no keys'}"
        )
    for name in sorted(allowed - given):
        raise ConfigError(f"missing key: {group}.{name}")


def _check_schedule(
    config: DictConfig, name: str, expected: Any, choices: Mapping[str, str | None]
) -> None:
    """Reject a key that the schedule of a parameter does not have."""
    node = config.strategy[name]
    if not isinstance(expected, DictConfig) or not isinstance(node, DictConfig):
        return
    if node.get("_target_") != expected.get("_target_"):
        return  # the user's own schedule; the constructor checks its keys
    for key in sorted({str(key) for key in node} - {str(key) for key in expected}):
        has = ", ".join(sorted(str(k) for k in expected if not str(k).startswith("_")))
        option = choices.get("strategy")
        own = OmegaConf.select(load(f"strategy/{option}"), name)
        hint = ""
        if isinstance(own, DictConfig) and f"strategy.{name}" in schedules_of(choices):
            hint = f"; strategy={option} has its own schedule, which cannot be replaced"
        raise ConfigError(f"unknown key 'strategy.{name}.{key}'; this schedule has: {has}{hint}")


def check_values(config: DictConfig) -> None:
    """Reject top-level numbers and words that are not allowed.

    Raises:
        ConfigError: naming the key, its value and what is allowed.
    """
    every = config.evaluate_every
    try:
        for key, (low, high) in INTEGERS.items():
            check_integer(key, config[key], low, high)
        check_number("checkpoint_seconds", config.checkpoint_seconds, 0)
        if not isinstance(every, str):
            check_integer("evaluate_every", every, 0, 10**9)
    except (ValueError, TypeError) as error:
        raise ConfigError(first_line(error)) from None
    if isinstance(every, str) and every != "auto":
        raise ConfigError(f"evaluate_every must be auto or an integer >= 0, got {every!r}")
    if every == 0 and config.evaluate_episodes != load("train").evaluate_episodes:
        raise ConfigError(
            f"evaluate_episodes={config.evaluate_episodes} needs evaluations: evaluate_every "
            "must be auto or an integer >= 1, got 0"
        )
    if config.evaluate_policy not in POLICIES:
        raise ConfigError(
            f"evaluate_policy must be one of {', '.join(POLICIES)}, got {config.evaluate_policy!r}"
        )
    if not isinstance(config.keep_weights, ListConfig):
        raise ConfigError(
            "keep_weights must be a list of iterations, such as [0,10,50], "
            f"got {config.keep_weights!r}"
        )


def check_actions(config: DictConfig, kind: str) -> None:
    """Reject options that do not support the environment's actions, and name those that do.

    Args:
        config: the configuration of the job.
        kind: the kind of the environment's actions, "discrete" or "continuous".

    Raises:
        ConfigError: if the strategy or the policy supports only the other kind.
    """
    wrong: list[str] = []
    supporting: list[str] = []
    for group in LIMITED:
        constructor = _constructor(config[group])
        if getattr(constructor, "actions", kind) != kind:
            wrong.append(constructor.__name__)
            supporting.append(f"{group}={'|'.join(options(group, kind))}")
    if wrong:
        raise ConfigError(
            f"the environment has {kind} actions, not supported by {' and '.join(wrong)}; "
            f"supported by {', '.join(supporting)}"
        )


def options(group: str, kind: str) -> list[str]:
    """The options of a group that support a kind of action."""
    files = files_of(group).items()
    found = ((name, _constructor(OmegaConf.load(path))) for name, path in files)
    return [name for name, constructor in found if getattr(constructor, "actions", None) == kind]


def _constructor(node: Any) -> Any:
    """The class that a configuration names; None if it does not exist."""
    try:
        return _locate(str(node.get("_target_")))
    except Exception:  # any error of the import; building it reports the error
        return None


def resolved(config: DictConfig) -> dict[str, Any]:
    """The configuration as plain data.

    Raises:
        ConfigError: if a mandatory value is missing or an interpolation fails.
    """
    try:
        container = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    except MissingMandatoryValue as error:
        raise ConfigError(f"{error.full_key} must be set, e.g. {error.full_key}=…") from None
    except OmegaConfBaseException as error:
        raise ConfigError(describe(error)) from None
    assert isinstance(container, dict)
    return cast(dict[str, Any], container)


def differences(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> list[str]:
    """The keys whose values differ between two configurations and can change the results."""
    found: list[str] = []
    for key in sorted({*old, *new}):
        if f"{prefix}{key}" in (*INERT, "policy.lr"):  # optimizer.lr takes it, and is compared
            continue
        a, b = old.get(key), new.get(key)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            found += differences(a, b, f"{prefix}{key}.")
        elif not same(a, b):
            found.append(f"{prefix}{key}: {a} before, {b} now")
    return found


def unreadable(words: Iterable[str]) -> str:
    """One line on the first argument that Hydra's grammar cannot read; empty if it can read all."""
    parser = OverridesParser.create()
    before = ""
    for word in words:
        flag, before = before, word
        if word.startswith("-") or flag in FLAGS:
            continue
        try:
            if word[:1] != "=":  # an empty key, which the grammar allows
                parser.parse_override(word)
                continue
        except HydraException:
            pass
        word = "".join(c if c.isprintable() else "?" for c in word)
        key, equals, value = word.partition("=")
        if not equals or not re.fullmatch(r"[\w.@/+~:-]+", key):
            return f"cannot read the argument {word!r}; arguments have the form key=value"
        quoted = value.replace("'", "\\'")
        remedy = f"{key}='{quoted}'"
        return f'cannot read {word}: put the value in quotes, twice for the shell: "{remedy}"'
    return ""


def describe(error: BaseException) -> str:
    """Describe an error of Hydra, OmegaConf or the file system in one line."""
    text = re.sub(r"^\w+ raised while resolving interpolation: |\n\s*full_key: .*", "", str(error),
                  flags=re.S)  # fmt: skip
    if text.startswith("Error merging override") and error.__cause__ is not None:
        text += f": {first_line(error.__cause__)}"
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    unknown = re.match(r"Could not override '([^']+)'", str(error))
    if isinstance(error, MissingConfigException):
        group, options = error.missing_cfg_file or "", error.options or []
        name, _, option = group.rpartition("/")
        if not name:
            return f"there is no configuration {option!r}; without --config-name it is 'train'"
        return f"unknown option {name}={option}; available: {', '.join(options)}"
    if unknown and re.match(r"env\.(kwargs|attributes)\b", unknown[1]):
        added = re.search(r"use (\+.*)", str(error))
        return f"'{unknown[1]}' does not exist yet; add it with +" + (
            f": {added[1]}" if added else ""
        )
    if unknown and unknown[1]:
        hint = alike(unknown[1]) or "; --help lists the keys of this configuration"
        return f"unknown key '{unknown[1]}'{hint}"
    if missing := re.search(r"Missing mandatory value: (\S+)", str(error)):
        return f"{missing[1]} must be set, e.g. {missing[1]}=…"
    if several := re.match(r"Ambiguous value for argument '((.+?)=(.*))'", str(error)):
        return (
            f"{several[1]} gives several values: add -m to run a job for each, or write "
            f"'{several[2]}=[{several[3]}]' for one list"
        )
    if "Config group override must be" in str(error):
        return (
            f"each of {', '.join(GROUPS)} must be the name of a file in conf/, not null or a list"
        )
    if isinstance(error, OSError) and error.filename:
        return f"cannot write {error.filename}: {error.strerror}"
    return " ".join(lines) or type(error).__name__
