"""From a Hydra configuration to built objects: names, checks, and one line for what is wrong.

The only module of the package that knows Hydra and OmegaConf. It imports torch only when a job is
built, so that ``--help``, ``--cfg`` and tab completion are quick.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from hydra.core.hydra_config import HydraConfig
from hydra.errors import InstantiationException, MissingConfigException
from hydra.types import RunMode
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from trl_explore.checks import LARGEST, MAX_THREADS, check_integer

if TYPE_CHECKING:
    from trl_explore.trainer import Trainer

CONF = Path(__file__).resolve().parent.parent / "conf"
GROUPS = ("env", "policy", "strategy", "loss", "optimizer", "collector")
INERT = ("output_dir", "restart", "threads", "episodes", "collector.threads")
"""Keys that change no result: they are not part of a job's name or identity."""


INTEGERS = {
    "seed": (0, LARGEST),
    "trials": (1, 10**7),
    "first_trial": (0, LARGEST - 10**7),
    "threads": (1, MAX_THREADS),
}
"""Keys of the top level that hold an integer, and its bounds."""
ABSENT = object()
"""Stands for the default of a key that ``conf/`` does not have."""


class ConfigError(ValueError):
    """A configuration that cannot be run; the message is one line."""


# Names


def register_resolvers() -> None:
    """Make ``${sweep_name:}`` and ``${job_name:}`` known to OmegaConf."""
    OmegaConf.register_new_resolver("sweep_name", _sweep_name, replace=True)
    OmegaConf.register_new_resolver("job_name", _job_name, replace=True)


def _choices(root: DictConfig) -> Mapping[str, str | None]:
    return root.hydra.runtime.choices


def _sweep_name(*, _root_: DictConfig) -> str:
    if not str(_root_.output_dir or "").strip():
        raise ConfigError("output_dir must name a folder, got nothing")
    return _choices(_root_).get("experiment") or "train"


def _job_name(*, _root_: DictConfig) -> str:
    return job_name(_root_, _choices(_root_))


def job_name(config: DictConfig, choices: Mapping[str, str | None]) -> str:
    """The strategy with its parameters, and every other value that differs from ``conf/``.

    Named by resolved values, so that ``temperature=1`` and ``temperature=1.0`` are one job, and
    different configurations never share a folder: ``epsilon_greedy,epsilon=0.1,seed=3``.
    """
    defaults = _defaults(choices)
    parts = [str(choices.get("strategy"))]
    parts += [
        f"{group}={choices.get(group)}"
        for group in GROUPS
        if group != "strategy" and choices.get(group) != _default_choices()[group]
    ]
    leaves = _leaves(defaults, config)
    for key in sorted(leaves, key=lambda key: (not key.startswith("strategy."), key)):
        value, default = OmegaConf.select(config, key), leaves[key]
        shown_always = key.startswith("strategy.") and not key.startswith("strategy._")
        same = default is not ABSENT and _same(value, default)
        if key in INERT or (same and not shown_always):
            continue
        if isinstance(default, float) and isinstance(value, int):
            value = float(value)
        parts.append(f"{key.removeprefix('strategy.')}={value}")
    name = quote(",".join(parts), safe="=,.+-_[] ").replace(" ", "")
    if len(name) <= 200:
        return name
    import hashlib

    return f"{name[:180]}-{hashlib.sha256(name.encode()).hexdigest()[:12]}"


def _same(value: Any, default: Any) -> bool:
    return value == default and isinstance(value, bool) == isinstance(default, bool)


def _default_choices() -> dict[str, str]:
    entries = OmegaConf.load(CONF / "train.yaml").defaults  # type: ignore[union-attr]
    named = (entry for entry in entries if isinstance(entry, DictConfig))
    return {str(group): option for entry in named for group, option in entry.items()}


def _defaults(choices: Mapping[str, str | None]) -> DictConfig:
    """What the files of ``conf/`` say for these choices, before any override."""
    defaults = OmegaConf.load(CONF / "train.yaml")
    assert isinstance(defaults, DictConfig)
    for group in GROUPS:
        path = CONF / group / f"{choices.get(group)}.yaml"
        defaults[group] = OmegaConf.load(path) if path.is_file() else {}
    experiment = CONF / "experiment" / f"{choices.get('experiment')}.yaml"
    if experiment.is_file():
        defaults = OmegaConf.merge(defaults, OmegaConf.load(experiment))
    assert isinstance(defaults, DictConfig)
    for key in ("defaults", "hydra"):
        defaults.pop(key, None)
    return defaults


def _leaves(defaults: DictConfig, config: DictConfig) -> dict[str, Any]:
    """Every key of the configuration that holds a value, with the value that ``conf/`` gives."""
    leaves: dict[str, Any] = {}

    def walk(node: DictConfig, prefix: str) -> None:
        for name in node:
            key = f"{prefix}{name}"
            if key == "hydra" or (OmegaConf.is_missing(node, name) and not prefix):
                continue
            child = None if OmegaConf.is_missing(node, name) else node[name]
            if isinstance(child, DictConfig):
                walk(child, f"{key}.")
            else:
                leaves[key] = _default(defaults, config, key)

    walk(config, "")
    return leaves


def _default(defaults: DictConfig, config: DictConfig, key: str) -> Any:
    """The value that ``conf/`` gives a key; where it points to another key, that one's value."""
    parent, _, name = key.rpartition(".")
    node = OmegaConf.select(defaults, parent, throw_on_missing=False) if parent else defaults
    if not isinstance(node, DictConfig) or name not in node or OmegaConf.is_missing(node, name):
        return ABSENT
    pointer = re.fullmatch(r"\$\{([\w.]+)\}", str(OmegaConf.to_container(node)[name]))  # type: ignore[index]
    return OmegaConf.select(config, pointer[1]) if pointer else node[name]


# Checks


def check_keys(config: DictConfig, choices: Mapping[str, str | None]) -> None:
    """Refuse keys that no file of ``conf/`` knows, which Hydra lets in with ``+key=value``.

    Raises:
        ConfigError: naming the key and the known ones.
    """
    known = set(_defaults(choices))
    for name in config:
        if name not in known:
            raise ConfigError(f"unknown key {name!r}; known: {', '.join(sorted(known))}")
    for name in sorted(known - {str(key) for key in config}):
        raise ConfigError(f"the key {name!r} has been removed, but is needed")
    for name in ("episodes", "restart"):
        if not isinstance(config[name], bool):
            raise ConfigError(f"{name} must be true or false, got {config[name]!r}")
    for group in GROUPS:
        _check_group(config, group, choices.get(group))


def _check_group(config: DictConfig, group: str, option: str | None) -> None:
    path = CONF / group / f"{option}.yaml"
    if not isinstance(config[group], DictConfig):
        raise ConfigError(f"{group} must name a file of conf/{group}/, got {config[group]}")
    if not path.is_file():
        return  # a file of the user's own; the constructor checks
    allowed = {str(key) for key in OmegaConf.load(path)}
    given = {str(key) for key in config[group]}
    for name in sorted(given - allowed):
        shown = sorted(key for key in allowed if not key.startswith("_"))
        raise ConfigError(
            f"unknown key '{group}.{name}'; {group}={option} has: {', '.join(shown) or 'no keys'}"
        )
    for name in sorted(allowed - given):
        raise ConfigError(f"the key '{group}.{name}' has been removed, but is needed")


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
        raise ConfigError(first_line(error)) from None
    assert isinstance(container, dict)
    return container  # type: ignore[return-value]


def differences(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> list[str]:
    """The keys in which two resolved configurations would give different results."""
    found: list[str] = []
    for key in sorted({*old, *new}):
        if f"{prefix}{key}" in INERT:
            continue
        a, b = old.get(key), new.get(key)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            found += differences(a, b, f"{prefix}{key}.")
        elif not _same(a, b):
            found.append(f"{prefix}{key}: {a} there, {b} here")
    return found


def describe(error: BaseException) -> str:
    """An error of Hydra, OmegaConf or the file system as one line."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    unknown = re.match(r"Could not override '([^']+)'", str(error))
    if isinstance(error, MissingConfigException):
        group, options = error.missing_cfg_file or "", error.options or []
        return f"there is no {group.replace('/', '=')}; available: {', '.join(options)}"
    if unknown and unknown[1]:
        return f"unknown key '{unknown[1]}'; --help lists the keys of this configuration"
    if "Config group override must be" in str(error):
        return (
            f"each of {', '.join(GROUPS)} must name one of its files in conf/, not null or a list"
        )
    if isinstance(error, OSError) and error.filename:
        return f"cannot write {error.filename}: {error.strerror}"
    return " ".join(lines) or type(error).__name__


def first_line(error: BaseException) -> str:
    """The first line of an error's message."""
    return str(error).strip().split("\n")[0] or type(error).__name__


# Building


def build_trainer(config: DictConfig) -> Trainer:
    """Everything that a job needs, built from its configuration.

    Raises:
        ConfigError: if a value is not allowed, before anything is trained or written.
    """
    from tensordict.nn import TensorDictSequential

    from trl_explore.actor import SoftmaxActor
    from trl_explore.trainer import Trainer
    from trl_explore.trials import Trials

    for key, (low, high) in INTEGERS.items():
        _build(None, lambda key=key, low=low, high=high: check_integer(key, config[key], low, high))
    trials = _build(
        None,
        lambda: Trials(
            config.trials,
            max_iterations=config.max_iterations,
            score_threshold=config.score_threshold,
            score_window=config.score_window,
        ),
    )
    streams = {"seed": config.seed, "first_trial": config.first_trial}
    strategy = _instantiate(config, "strategy")()
    env = _instantiate(config, "env")(trials=config.trials, **streams)
    policy = _instantiate(config, "policy")(env=env, **streams)
    optimizer = _instantiate(config, "optimizer")(policy.parameters())
    loss = _instantiate(config, "loss")(SoftmaxActor(policy), trials=config.trials)
    collector = _instantiate(config, "collector")(env, TensorDictSequential(policy, strategy))
    return _build("loss", lambda: Trainer(collector, loss, optimizer, trials))


def _instantiate(config: DictConfig, group: str) -> Callable[..., Any]:
    """The constructor that a group's configuration stands for."""

    def construct(*args: Any, **kwargs: Any) -> Any:
        def call() -> Any:
            built = instantiate(config[group], _convert_="all", _partial_=True)
            return built(*args, **kwargs)

        return _build(group, call)

    return construct


def _build(group: str | None, call: Callable[[], Any]) -> Any:
    """Call, and turn an error of the arguments into one line with the group's name."""
    try:
        return call()
    except ConfigError:
        raise
    except InstantiationException as error:
        raise ConfigError(_of(group, describe(error.__cause__ or error))) from error
    except MemoryError as error:
        raise ConfigError(_of(group, "not enough memory for so many trials")) from error
    except (ValueError, TypeError, OverflowError) as error:
        raise ConfigError(_of(group, describe(error))) from error


def _of(group: str | None, message: str) -> str:
    return f"{group}: {message}" if group else message


def current_choices() -> dict[str, str | None]:
    """Which option of every group the running job has."""
    return dict(HydraConfig.get().runtime.choices)


def current_folder() -> Path:
    """The folder of the running job."""
    return Path(HydraConfig.get().runtime.output_dir)


def is_multirun() -> bool:
    """Whether the running job belongs to a sweep."""
    return HydraConfig.get().mode == RunMode.MULTIRUN


def save_hydra(folder: Path, config: DictConfig) -> None:
    """Write ``.hydra/`` as Hydra does."""
    hydra = OmegaConf.create({"hydra": HydraConfig.get()})
    files = {
        "config.yaml": config,
        "hydra.yaml": hydra,
        "overrides.yaml": HydraConfig.get().overrides.task,
    }
    (folder / ".hydra").mkdir(exist_ok=True)
    for name, node in files.items():
        (folder / ".hydra" / name).write_text(OmegaConf.to_yaml(node), encoding="utf-8")
