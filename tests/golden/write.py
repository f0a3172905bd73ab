"""Write ``golden.json`` anew: ``python tests/golden/write.py``."""

# ruff: noqa: E402 - the tests are no package; the path comes first

from __future__ import annotations

import json
import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]

from conftest import build_trainer
from golden.runs import COLLECTORS, FILE, RUN, STRATEGIES, summary

found = {}
for name, strategy in STRATEGIES.items():
    trainer = build_trainer(strategy(), 5, collector=COLLECTORS["fused"], **RUN)
    trainer.run()
    found[name] = summary(trainer)
FILE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
