"""The time of one call of each strategy, as a ratio to TorchRL's ``EGreedyModule``.

    python benchmarks/strategies.py [--rounds 200]

The ratio is to ``EGreedyModule`` with the ``QValueModule`` that it needs, on one thread: the least
time of all rounds. Every round calls everything in turn, so that noise of the machine hits all
alike. The table is that of docs/torchrl.md.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import torch
from tables import table
from tensordict import TensorDict
from torchrl.data import Categorical, OneHot
from torchrl.modules import EGreedyModule, QValueModule

from trl_explore import strategies

ACTIONS, CALLS = 4, 5
STRATEGIES: Mapping[str, Callable[..., Any]] = {
    "Random": strategies.Random,
    "Argmax": strategies.Argmax,
    "EpsilonGreedy": partial(strategies.EpsilonGreedy, 0.1),
    "Softmax": partial(strategies.Softmax, 0.7),
    "EpsilonSoftmax": partial(strategies.EpsilonSoftmax, 0.1, 0.7),
    "MaxBoltzmann": partial(strategies.MaxBoltzmann, 0.3, 0.7),
    "FullMixture": partial(strategies.FullMixture, temperature=0.7),
    "VDBE": partial(strategies.VDBE, 0.4),
}


def ratios(batch: int, kind: type, rounds: int) -> list[float]:
    """The time of each strategy divided by that of TorchRL's pair."""
    spec = kind(ACTIONS)
    data = TensorDict({"action_value": torch.randn(batch, ACTIONS)}, [batch])
    value = QValueModule(spec=spec)
    value(data)
    theirs, copy = EGreedyModule(spec=spec.expand(batch, *spec.shape)), data.clone()
    calls: list[Callable[[], object]] = [lambda: theirs(value(copy))]
    for make in STRATEGIES.values():
        calls.append(partial(make(spec=spec, logits_key="action_value"), data))
    least = [float("inf")] * len(calls)
    with torch.no_grad():
        for _ in range(rounds):
            least = [min(before, seconds(call)) for before, call in zip(least, calls, strict=True)]
    return [own / least[0] for own in least[1:]]


def seconds(call: Callable[[], object]) -> float:
    """The wall time of some calls."""
    started = time.perf_counter()
    for _ in range(CALLS):
        call()
    return time.perf_counter() - started


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Time one call of each strategy.")
    parser.add_argument("--rounds", type=int, default=200)
    rounds = parser.parse_args().rounds
    torch.set_num_threads(1)
    cells = [(batch, kind) for batch in (1, 64, 4096) for kind in (Categorical, OneHot)]
    columns = [ratios(batch, kind, rounds) for batch, kind in cells]
    head = ["strategy", *(f"{batch}, `{kind.__name__}`" for batch, kind in cells)]
    rows = zip(STRATEGIES, *columns, strict=True)
    print(table(head, ([f"`{name}`", *(f"{x:.2f}" for x in xs)] for name, *xs in rows)))


if __name__ == "__main__":
    main()
