"""What evaluating by default costs: ``python benchmarks/evaluation.py [--trials N ...]``.

Trains the thesis's strategies with and without evaluation, alternating in one process, and prints
the processor time of training and the share that evaluation adds, as the table of
``docs/measures.md``. Building the agents and writing files are not timed.
"""

from __future__ import annotations

import argparse
import time

import torch
from runs import STRATEGIES, build


def seconds(strategy: str, trials: int, evaluates: bool) -> tuple[float, float]:
    """Processor seconds of training, and evaluation episodes per trial."""
    trainer = build(strategy, trials, evaluates=evaluates)
    started = time.process_time()
    trainer.run()
    taken = time.process_time() - started
    trainer.close()
    played = 0 if trainer.evaluator is None else len(trainer.evaluator.rows()["trial"])
    return taken, played / trials


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--trials", type=int, nargs="+", default=[30, 300, 1500])
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print("| trials | strategy | training, s | evaluation adds | episodes per trial |")
    print("|---:|---|---:|---:|---:|")
    for trials in options.trials:
        totals = [0.0, 0.0]
        for strategy in STRATEGIES:
            runs = [
                [seconds(strategy, trials, on) for on in (False, True)]
                for _ in range(options.repeats)
            ]
            off, on = (min(run[k][0] for run in runs) for k in range(2))
            totals = [totals[0] + off, totals[1] + on]
            played = f"{runs[0][1][1]:.0f}"
            print(f"| {trials:,} | {strategy} | {off:.3f} | {on / off - 1:.0%} | {played} |")
        share = totals[1] / totals[0] - 1
        print(f"| {trials:,} | all | {totals[0]:.3f} | {share:.0%} | |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
