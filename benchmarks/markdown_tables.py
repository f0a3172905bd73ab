"""The measurements as Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from machine import description
from phases import PHASES
from plan import PHASE_TRIALS, SIZES, THESIS_TRIALS, Case, Measured
from runs import CAP, STRATEGIES
from targets import targets


def table(head: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """A Markdown table with padded cells; the first ``left`` columns are left-aligned."""
    cells = [list(head), *map(list, rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    rule = ["-" * w if i < left else "-" * (w - 1) + ":" for i, w in enumerate(widths)]
    lines = [
        " | ".join(
            cell.ljust(w) if i < left else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in (cells[0], rule, *cells[1:])
    ]
    return "\n".join(f"| {line} |" for line in lines)


def significant(x: float) -> str:
    """Three significant digits, with commas between thousands."""
    if x == 0 or abs(x) >= 100:
        digits = max(0, len(str(int(abs(x)))) - 3)
        return f"{round(x, -digits):,.0f}"
    return f"{x:.3g}" if abs(x) < 1 else f"{x:.2f}" if abs(x) < 10 else f"{x:.1f}"


def speeds(m: Measured) -> str:
    """Frames per second of each collector, by number of trials."""
    plain, stock = m.speed(Case("plain")), m.speed(Case("stock"))
    rows = []
    for case, runs in m.runs.items():
        if case.kind == "thesis" or (case.kind == "plain" and case.strategy != "softmax"):
            continue
        speed, each = m.speed(case), [run.speed for run in runs]
        rows.append(
            (
                NAMES[case.kind],
                f"{case.trials:,}",
                str(case.threads),
                significant(speed),
                f"{significant(min(each))} to {significant(max(each))}",
                significant(1e9 / speed),
                significant(speed / plain),
                significant(speed / stock),
                busy(m, case),
            )
        )
    head = ("", "trials", "threads", "frames/s", "range", "ns per frame", "× plain", "× stock")
    return table((*head, "busy lanes"), rows)


NAMES = {
    "plain": "plain loop",
    "stock": "TorchRL, stock",
    "lanes": "TorchRL, lanes",
    "fused": "fused",
}


def busy(m: Measured, case: Case) -> str:
    """The mean number of lanes that advance in a step of the TorchRL collector."""
    if case.kind != "lanes":
        return ""
    return significant(m.runs[case][0].frames / m.runs[case][0].steps)


def thesis(m: Measured) -> str:
    """The thesis's experiment, by strategy."""
    rows = []
    for strategy in STRATEGIES:
        case = Case("thesis", THESIS_TRIALS, strategy=strategy)
        run, seconds, plain = m.runs[case][0], m.seconds(case), m.plain_seconds(strategy)
        rows.append(
            (
                strategy,
                f"{run.frames:,}",
                f"{run.iterations:,}",
                significant(m.speed(Case("plain", strategy=strategy))),
                significant(plain),
                significant(seconds),
                significant(plain / seconds),
                significant(1e6 * seconds / run.iterations),
            )
        )
    rows.append(_total(m))
    head = ("strategy", "frames", "iterations", "plain frames/s", "plain s", "fused s", "ratio")
    return table((*head, "µs per iteration"), rows)


def _total(m: Measured) -> tuple[str, ...]:
    jobs = [m.runs[Case("thesis", THESIS_TRIALS, strategy=s)][0] for s in STRATEGIES]
    frames, iterations = sum(j.frames for j in jobs), sum(j.iterations for j in jobs)
    plain, seconds = sum(map(m.plain_seconds, STRATEGIES)), m.thesis_seconds()
    return (
        "all",
        f"{frames:,}",
        f"{iterations:,}",
        significant(frames / plain),
        significant(plain),
        significant(seconds),
        significant(plain / seconds),
        significant(1e6 * seconds / iterations),
    )


def iteration(m: Measured) -> str:
    """The time of each part of an iteration."""
    rows = []
    for name in (*PHASES, "rest", "total"):
        cells = [name]
        for trials in PHASE_TRIALS:
            part, total = m.phase(trials, name), m.phase(trials, "total")
            cells += [significant(part), f"{part / total:.0%}"]
        rows.append(cells)
    head = [x for n in PHASE_TRIALS for x in (f"{n:,} trials, µs", "share")]
    return table(["part", *head], rows)


def start_up(m: Measured) -> str:
    """Seconds of each command."""
    rows = [(f"`{name}`", f"{m.start(name):.2f}") for name in m.start_up[0]]
    return table(("command", "seconds"), rows)


def reached(m: Measured) -> str:
    """The targets and the measured values."""
    rows = [
        (t.name, t.wanted, f"{significant(t.measured)}{t.unit}", "met" if t.met else "not met")
        for t in targets(m)
    ]
    return table(("", "target", "measured", ""), rows)


def document(m: Measured, load: str, figure: str | None) -> str:
    """All tables, with the method and the machine.

    Args:
        m: the measurements.
        load: load average before the run.
        figure: file name of the scaling figure, if there is one.
    """
    s = m.settings
    plain_trials = s.alone * s.repeats
    machine = [*description(), ("load average before", load)]
    whole = s.cap == CAP and s.lanes_cap == CAP
    picture = f"![Frames per second against the number of trials]({figure})\n\n" if figure else ""
    rounds = str(s.repeats)
    if s.slow_repeats != s.repeats:
        rounds += f" ({s.slow_repeats} for the lanes and for {max(SIZES):,} trials)"
    note = "" if whole else f"{SHORTENED.format(s.cap, s.lanes_cap)}\n\n"
    return f"""# Speed

{note}{table(("", "this machine"), machine, left=2)}

CartPole-v1, linear policy, REINFORCE with Adam. Only training is timed, after imports and \
compilation. A run ends when the last trial has converged or reached {s.cap:,} iterations. \
All numbers are from one run of `benchmarks/speed.py` and are medians over all rounds. \
Number of rounds: {rounds}. Each round runs every case once, so that noise of the machine \
affects all cases alike.

## Frames per second, softmax

{picture}{speeds(m)}

- plain loop: gymnasium and numpy (`plain.py`), {s.alone} trials in each round, one after the other.
- TorchRL, stock: TorchRL's `Collector` over one `GymEnv` with the same transforms, the weights \
of a trained policy, and the strategy; collection only, {s.stock_frames:,} frames in each round.
- TorchRL, lanes: `TorchRLCollector`, a whole run with its updates; *busy lanes* is the mean \
number of unfinished lanes in a step.
- fused: `FusedCollector`, a whole run with its updates; 1 trial: {s.alone} trials in each round, \
one after the other.
- Dashed lines in the figure show cases that run one trial after the other, so that their speed \
does not depend on the number of trials.

## The thesis: five strategies, {THESIS_TRIALS} trials each

{thesis(m)}

Fused: five jobs in one process, one thread. Plain: the time for the same number of frames, at the \
median speed over {plain_trials} trials of each strategy, {s.alone} different trials in each round.

## Time of the parts of an iteration

{iteration(m)}

Softmax, one thread, averaged over whole runs, in which the number of active trials decreases. \
*Optimiser* includes zeroing the gradients; *loss* includes the gradient; *check* tests for values \
that are not finite; *rest* is the loop and the schedules.

## Start-up

{start_up(m)}

Whole processes, with warm caches. *import torchrl* imports its environments, collectors and \
objectives. `train.py` trains {THESIS_TRIALS} softmax trials and writes their files.

## Memory

Peak resident memory of a process that trains {max(SIZES):,} softmax trials: {m.memory[1]:.2f} GB. \
This includes {m.memory[0]:.2f} GB after the imports.

## Targets

{reached(m)}
"""


SHORTENED = (
    "**Short runs, to check that the program works: at most {} iterations, {} for the lanes. "
    "Not a measurement.**"
)
