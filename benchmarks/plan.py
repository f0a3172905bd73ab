"""The cases to measure, their sizes, and the rounds of measurement."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import phases
import processes
import runs
from machine import cores
from runs import CAP, STRATEGIES, Run

SIZES = (1, 30, 300, 1_500, 15_000)
"""Numbers of trials for the fused collector."""
LANES = (1, 30, 300)
"""Numbers of trials for the TorchRL collector."""
BOTH_CORES = (1_500, 15_000)
"""Numbers of trials that are also measured with two threads."""
PHASE_TRIALS = (30, 1_500)
THESIS_TRIALS = 30


@dataclass(frozen=True)
class Settings:
    """How much to measure.

    Attributes:
        repeats: rounds over all cases.
        slow_repeats: rounds that include the slowest cases.
        cap: maximum iterations of a trial; the thesis uses 1000.
        lanes_cap: the same for the TorchRL collector.
        alone: trials per round that run alone. The plain loop runs different trials in each round,
            so that five rounds make the thesis's 30; the fused collector runs the first ones.
        stock_frames: frames of the stock collector.
    """

    repeats: int = 5
    slow_repeats: int = 3
    cap: int = CAP
    lanes_cap: int = CAP
    alone: int = 6
    stock_frames: int = 5_000


QUICK = Settings(repeats=2, slow_repeats=1, cap=60, lanes_cap=6, alone=2, stock_frames=1_000)


@dataclass(frozen=True)
class Case:
    """One kind of run: "plain", "stock", "lanes", "fused", or "thesis" (fused, 30 trials)."""

    kind: str
    trials: int = 1
    threads: int = 1
    strategy: str = "softmax"


@dataclass
class Measured:
    """All measurements, with one entry per round."""

    settings: Settings
    runs: dict[Case, list[Run]] = field(default_factory=dict)
    phases: dict[int, list[dict[str, float]]] = field(default_factory=dict)
    start_up: list[dict[str, float]] = field(default_factory=list)
    memory: tuple[float, float] = (0.0, 0.0)
    """Memory in GB of a process after its imports, and after training 15,000 trials."""

    def speed(self, case: Case) -> float:
        """Median frames per second."""
        return statistics.median(run.speed for run in self.runs[case])

    def seconds(self, case: Case) -> float:
        """Median seconds."""
        return statistics.median(run.seconds for run in self.runs[case])

    def thesis_seconds(self) -> float:
        """Median seconds of the five fused jobs of 30 trials each, in one process."""
        jobs = (self.runs[Case("thesis", THESIS_TRIALS, strategy=s)] for s in STRATEGIES)
        return statistics.median(runs.together(job).seconds for job in zip(*jobs, strict=True))

    def plain_seconds(self, strategy: str) -> float:
        """Seconds of the plain loop for the number of frames of the thesis's job."""
        frames = self.runs[Case("thesis", THESIS_TRIALS, strategy=strategy)][0].frames
        return frames / self.speed(Case("plain", strategy=strategy))

    def start(self, command: str) -> float:
        """Median seconds of a command of ``processes.commands``."""
        return statistics.median(seconds[command] for seconds in self.start_up)

    def start_beyond_torchrl(self) -> float:
        """Median seconds of ``train.py`` minus those of importing torchrl."""
        return statistics.median(s["train.py"] - s["import torchrl"] for s in self.start_up)

    def phase(self, trials: int, name: str) -> float:
        """Median microseconds per iteration."""
        return statistics.median(parts[name] for parts in self.phases[trials])


def thread_counts(trials: int) -> tuple[int, ...]:
    """The numbers of threads to measure the fused collector with."""
    return (1, 2) if trials in BOTH_CORES and cores() >= 2 else (1,)


def plan(settings: Settings) -> dict[Case, Callable[[int], Run]]:
    """The function that runs each case in a given round, in the order of a round."""
    cap = settings.cap
    weight = runs.trained_weight()
    todo: dict[Case, Callable[[int], Run]] = {}

    def plain(strategy: str) -> Callable[[int], Run]:
        n = settings.alone
        return lambda repeat: runs.plain(strategy, range(repeat * n, repeat * n + n), cap)

    def thesis(strategy: str) -> Callable[[int], Run]:
        return lambda _: runs.fused(strategy, THESIS_TRIALS, max_iterations=cap)

    def lanes(trials: int) -> Callable[[int], Run]:
        return lambda _: runs.lanes(trials, settings.lanes_cap)

    def fused(trials: int, threads: int) -> Callable[[int], Run]:
        return lambda _: runs.fused("softmax", trials, threads, max_iterations=cap)

    for strategy in STRATEGIES:
        todo[Case("plain", strategy=strategy)] = plain(strategy)
        todo[Case("thesis", THESIS_TRIALS, strategy=strategy)] = thesis(strategy)
    todo[Case("stock")] = lambda _: runs.stock(weight, settings.stock_frames)
    for trials in LANES:
        todo[Case("lanes", trials)] = lanes(trials)
    for trials in SIZES:
        for threads in thread_counts(trials):
            todo[Case("fused", trials, threads)] = fused(trials, threads)
    todo[Case("fused", 1)] = lambda _: runs.fused_alone(settings.alone, cap)
    return todo


def is_slow(case: Case) -> bool:
    """Whether a case is slow, so that fewer rounds include it."""
    return case.kind == "lanes" or case.trials >= 15_000


def warm_up() -> None:
    """Compile or load all code that the rounds run."""
    for strategy in STRATEGIES:
        runs.plain(strategy, [0], 5)
        runs.fused(strategy, THESIS_TRIALS, max_iterations=3)
    for trials in SIZES:
        for threads in thread_counts(trials):
            runs.fused("softmax", trials, threads, max_iterations=3)
    runs.lanes(3, 2)
    phases.phases(1, 2)
    processes.start_up()


def measure(settings: Settings) -> Measured:
    """Run all cases in each round, so that noise of the machine affects all cases alike."""
    started = time.perf_counter()

    def say(what: str) -> None:
        print(f"{time.perf_counter() - started:6.0f} s  {what}", file=sys.stderr, flush=True)

    say("warming up")
    warm_up()
    todo, measured = plan(settings), Measured(settings)
    for repeat in range(settings.repeats):
        say(f"round {repeat + 1} of {settings.repeats}")
        for case, run in todo.items():
            if repeat < settings.slow_repeats or not is_slow(case):
                measured.runs.setdefault(case, []).append(run(repeat))
        for trials in PHASE_TRIALS:
            measured.phases.setdefault(trials, []).append(phases.phases(trials, settings.cap))
        measured.start_up.append(processes.start_up())
    say("memory")
    measured.memory = processes.memory(max(SIZES), settings.cap)
    say("done")
    return measured
