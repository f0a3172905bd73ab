"""The map as one page that needs no network."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment
from markupsafe import Markup

HERE = Path(__file__).parent
ORDER = ("CartPole-v1", "FrozenLake-v1", "trl_explore/Catch-v0")
"""The first environments of the page; others follow."""


def page(found: Mapping[str, Any]) -> str:
    """The page of what ``cells.read_cells`` has found."""
    tasks, cells = found["tasks"], found["cells"]
    rank = [ORDER.index(t["id"]) if t["id"] in ORDER else len(ORDER) for t in tasks]
    order = sorted(range(len(tasks)), key=lambda i: (rank[i], tasks[i]["id"]))
    cells = [{**cell, "task": order.index(cell["task"])} for cell in cells]
    cells.sort(key=lambda cell: (cell["task"], cell["corrected"], cell["T"], cell["w"]))
    counts = sorted({cell["n"] for cell in cells})
    data = {"tasks": [tasks[i] for i in order], "cells": cells}
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    template = Environment(autoescape=True, keep_trailing_newline=True).from_string(
        (HERE / "map.html").read_text(encoding="utf-8")
    )
    own = {
        name: Markup((HERE / f"map.{name}").read_text(encoding="utf-8")) for name in ("css", "js")
    }
    trials = " to ".join(f"{n:,}" for n in dict.fromkeys((counts[0], counts[-1])))
    return template.render(data=Markup(text), trials=trials, **own)
