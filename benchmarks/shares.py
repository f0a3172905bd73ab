"""How often do the intervals of the shares of the bias cover? The argument is a folder.

It has the jobs of ``experiment=why`` and ``experiment=why_as_if`` with some thousand trials.
Samples of n trials are drawn from them; the truth is the share of all trials.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from trl_explore.jobs.reading import read_job
from trl_explore.report.crossings import Cell, crossings
from trl_explore.statistics.decomposition import Cells, aligned, share_of
from trl_explore.statistics.outcomes import judged

SAMPLES = 1000


def shares(cells: Cells) -> tuple:
    """The shares of the bias: on the data of softmax, on those of the strategy, and their mean."""
    assert cells.assumed is not None
    assert cells.corrected is not None
    parts = cells.assumed - cells.reference, cells.plain - cells.corrected, cells.bias
    return tuple(share_of(part, cells.gap) for part in parts)


def main(folder: Path) -> None:
    """Print the table as Markdown."""
    found = [read_job(file.parent) for file in sorted(folder.rglob("run.json"))]
    runs = [Cell(str(o.config["env"]["id"]), o, judged(o, "learned")) for o in found]
    draws = np.random.default_rng(0)
    print("| strategy | n | data of softmax | data of the strategy | both |")
    print("|---|---:|---:|---:|---:|")
    for crossing in crossings(runs):
        samples = {name: run.samples()["learning"] for name, run in crossing.cells.items()}
        columns = [s.keys for s in samples.values()], [s.values for s in samples.values()]
        arrays = dict(zip(samples, aligned(*columns), strict=True))
        truth = shares(Cells(**arrays))
        if np.isnan(truth[0].value):
            continue
        for n in (30, 100):
            hits = np.zeros(3)
            for _ in range(SAMPLES):
                rows = draws.choice(len(arrays["plain"]), n, replace=False)
                own = shares(Cells(**{name: x[rows] for name, x in arrays.items()}))
                hits += [not o.outside(t.value, t.value) for o, t in zip(own, truth, strict=True)]
            cells = " | ".join(f"{100 * share:.1f}" for share in hits / SAMPLES)
            print(f"| {crossing.label} | {n} | {cells} |")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
