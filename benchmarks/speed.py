"""Measure the speed of everything: ``python benchmarks/speed.py [--quick] [--repeats N]``.

Prints tables and writes them to ``results.md``, with the figures ``scaling.svg`` and
``scaling.png``, in the folder of this file. With --quick, every run is short. This takes about a
minute and shows that everything works. Such numbers are not measurements and are written only to
the folder that --out names.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import markdown_tables
import scaling
import torch
from machine import load
from plan import QUICK, Settings, measure

HERE = Path(__file__).resolve().parent


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="short runs, as a check")
    parser.add_argument("--repeats", type=int, metavar="N", help="rounds (default: 5; quick: 2)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the files")
    parsed = parser.parse_args()
    if parsed.repeats is not None and parsed.repeats < 1:
        parser.error(f"--repeats {parsed.repeats}: at least 1")
    return parsed


def settings(quick: bool, repeats: int | None) -> Settings:
    """The settings that the command line asks for."""
    chosen = QUICK if quick else Settings()
    if repeats is None:
        return chosen
    return replace(chosen, repeats=repeats, slow_repeats=min(repeats, chosen.slow_repeats))


def main() -> int:
    """Measure, print and write."""
    options = arguments()
    folder = options.out or (None if options.quick else HERE)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    before = load()
    measured = measure(settings(options.quick, options.repeats))
    figure = scaling.write(measured, folder) if folder is not None else None
    document = markdown_tables.document(measured, before, figure)
    print(document, end="")
    if folder is not None:
        (folder / "results.md").write_text(document, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
