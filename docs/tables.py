"""Write the tables of options.md from conf/ and the classes: python docs/tables.py.

A table stands between two comments, ``<!-- name -->`` and ``<!-- end of name -->``. A test compares
the page with what this program would write.
"""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Any, cast

import yaml

from trl_explore.config import CONF, ConfigError
from trl_explore.config.composing import build
from trl_explore.names import STRATEGIES
from trl_explore.training.trainer import Trainer

PAGE = Path(__file__).with_name("options.md")
HIDDEN = {"_target_", "_partial_", "defaults", "hydra", "episodes_per_update"}
CONTINUOUS = ["env=pendulum", "policy=gaussian_linear"]
ORDINARY = ["trials=1", "evaluate_every=0", "env.workers=1"]
Rows = list[list[str]]


def read(group: str) -> dict[str, tuple[str, dict[str, Any]]]:
    """The files of a group: name -> (what its first lines say, its keys with their defaults)."""
    found = {}
    for path in sorted((CONF / group).glob("*.yaml")):
        text = path.read_text(encoding="utf-8")
        comment = cast(re.Match[str], re.match(r"(?:#.*\n)*", text))[0]
        lines = [line.lstrip("# ") for line in comment.splitlines() if "@package" not in line]
        found[path.stem] = " ".join(lines), yaml.safe_load(text) or {}
    return found


def shown(keys: dict[str, Any], prefix: str = "") -> str:
    """Keys with their defaults, as they are given on the command line."""
    words = []
    for key, value in keys.items():
        if isinstance(value, dict) and key not in HIDDEN:
            words.append(shown(value, f"{prefix}{key}."))
        elif key not in HIDDEN and "defaults" not in key:
            plain = value is None or isinstance(value, bool)
            text = json.dumps(value) if plain else str(value).replace(" ", "")
            words.append(f"`{prefix}{key}={text}`")
    return " ".join(word for word in words if word)


def options(group: str) -> Rows:
    """All files of a group."""
    rows = [[f"`{group}=`", "what it is", "keys and defaults"]]
    for name, (said, keys) in read(group).items():
        rows.append([f"`{name}`", said, shown(keys)])
    return rows


@cache
def tried(*words: str) -> Trainer | None:
    """The trainer of a job; None if its parts do not go together."""
    try:
        return build(*words, *ORDINARY)
    except ConfigError:
        return None


def collector(*words: str) -> str:
    """The collector that ``auto`` takes for a job."""
    trainer = tried(*words)
    return type(trainer.collector).__name__.removesuffix("Collector").lower() if trainer else "–"


def collectors(strategy: str) -> str:
    """The collectors of a strategy of discrete actions, and on what they depend."""
    usual = collector(strategy)
    text = usual
    if (table := collector(strategy, "env=frozenlake", "policy=tabular")) != usual:
        text += f"; {table} with `policy=tabular`"
    if (several := collector(strategy, "episodes_per_update=2")) != usual:
        text += f"; {several} with `episodes_per_update` > 1"
    return text


def strategies(continuous: bool) -> Rows:
    """What can be done with each strategy of discrete, or of continuous, actions."""
    rows = [["`strategy=`", "what it does", "parameters", "exact", "differentiable", "collector"]]
    for name, (_, keys) in read("strategy").items():
        discrete = tried(f"strategy={name}")
        trainer = discrete or tried(f"strategy={name}", *CONTINUOUS)
        assert trainer is not None, name
        if (discrete is None) != continuous:
            continue
        strategy = trainer.collector.strategy
        yes = ["yes" if flag else "no" for flag in (strategy.exact, strategy.differentiable)]
        found = (collector(f"strategy={name}", *CONTINUOUS) if continuous
                 else collectors(f"strategy={name}"))  # fmt: skip
        rows.append([f"`{name}`", STRATEGIES[name].does, shown(keys), *yes, found])
    return rows


def environments() -> Rows:
    """The environments, the rules of their trials, and the fastest collector."""
    rows = [["`env=`", "what it is", "longest episode", "threshold", "cap", "collector"]]
    for name, (said, keys) in read("env").items():
        words = [f"env={name}"]
        found = collector(*words)
        if found == "–":
            found = collector(*words, "policy=gaussian_linear", "strategy=gaussian")
        steps, least = keys["max_steps"], keys["score_threshold"]
        usual = ["–" if value in (None, "???") else str(value) for value in (steps, least)]
        cap = str(keys["max_iterations"])
        rows.append([f"`{name}`", said, *usual, cap, found if found != "–" else "stepping"])
    return rows


def keys() -> Rows:
    """The keys of train.yaml that are in no group, with the comments beside and above them."""
    rows, above = [["key", "default", "meaning"]], ""
    text = (CONF / "train.yaml").read_text(encoding="utf-8")
    for line in text[text.index("\n\n") : text.index("\nhydra:")].splitlines():
        found = re.match(r"(\w+): ?([^#]*?) *(?:# (.*))?$", line)
        if line.startswith("# "):
            above = f"{above} {line[2:]}".strip()
        elif not line:
            above = ""
        elif found and found[2]:
            rows.append([f"`{found[1]}`", f"`{found[2]}`", found[3] or above])
        elif line.startswith("      ") and "#" in line:
            rows[-1][2] += " " + line.split("# ", 1)[1]
    return rows


TABLES = {
    "discrete": lambda: strategies(False),
    "continuous": lambda: strategies(True),
    "environments": environments,
    "keys": keys,
    **{name.rsplit("/", 1)[-1]: lambda name=name: options(name) for name in (
        "correction", "baseline", "policy", "schedule", "optimizer", "loss", "collector",
        "experiment", "hydra/launcher",
    )},
}  # fmt: skip
"""The tables of the page, by name."""


def markdown(rows: Rows) -> str:
    """A table; a vertical bar in a cell would end it."""
    lines = [" | ".join(cell.replace("|", "\\|") for cell in row) for row in rows]
    lines.insert(1, "|".join("---" for _ in rows[0]))
    return "".join(f"| {line} |\n" if "---" not in line else f"|{line}|\n" for line in lines)


def written(page: str) -> str:
    """The page with its tables replaced by the present ones."""
    for name, table in TABLES.items():
        first, last = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
        if first not in page:
            raise ValueError(f"options.md has no table {name}")
        before, rest = page.split(first, 1)
        page = before + first + "\n" + markdown(table()) + "\n" + last + rest.split(last, 1)[1]
    return page


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
