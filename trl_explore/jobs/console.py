"""Terminal output: a live line while a job runs, and a table at the end."""

from __future__ import annotations

import sys
import time
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING, TextIO

import numpy as np
from numpy.typing import NDArray

from trl_explore.statistics.outcomes import Outcomes, lower_median

if TYPE_CHECKING:
    from trl_explore.training.trials import Trials

REFRESH = 0.2
"""Seconds between two refreshes of the live line."""


class Bar:
    """A line on a terminal, cut to its width, that shows how much is done; nothing elsewhere.

    Args:
        label: what is running.
        stream: the stream to write to.
    """

    quiet = False
    """Whether several processes share the terminal, so that none shows a line."""

    def __init__(self, label: str, stream: TextIO = sys.stderr) -> None:
        self.live = stream.isatty() and not self.quiet
        self.shown = time.perf_counter()
        if not self.live:
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn
        from rich.table import Column

        class Visible(Console):
            def show_cursor(self, show: bool = True) -> bool:
                return False  # a killed process would leave it hidden

        cut = (Column(no_wrap=True, overflow="ellipsis", ratio=ratio) for ratio in (1, None))
        names = ("{task.description}", "{task.fields[text]}")
        left, right = (
            TextColumn(name, markup=False, table_column=column, style="")
            for name, column in zip(names, cut, strict=True)
        )
        self._progress = Progress(
            left, BarColumn(10), right, console=Visible(file=stream), auto_refresh=False,
            transient=True, redirect_stdout=False, redirect_stderr=False, expand=True,
        )  # fmt: skip
        self._task = self._progress.add_task(printable(label), text="")

    @property
    def due(self) -> bool:
        """Whether the line is shown, and its last refresh is long enough ago."""
        return self.live and time.perf_counter() - self.shown >= REFRESH

    def show(self, done: float, total: float, text: str = "") -> None:
        """Show that ``done`` of ``total`` is done, with a text after it."""
        if self.live:
            self.shown = time.perf_counter()
            self._progress.update(self._task, completed=done, total=total, text=text)
            if self._progress.live.is_started:
                self._progress.refresh()
            else:
                self._progress.start()

    def close(self) -> None:
        """Remove the line."""
        if self.live:
            self._progress.stop()


class Progress(Bar):
    """A job's line: trials converged so far, mean score, frames/s, upper bound on the time left.

    In a sweep it starts with the number of the job and the time left for the jobs after it, if they
    take as long as those before.

    Args:
        label: the name of the job.
        records: the records of the shards; progress counts from their current state.
        stream: the stream to write to.
        place: the number of the job in its sweep, from 0, and the number of jobs.
    """

    began = time.perf_counter()
    """When this process began its first job [s]."""

    def __init__(
        self,
        label: str,
        records: Sequence[Trials],
        stream: TextIO = sys.stderr,
        place: tuple[int, int] = (0, 1),
    ) -> None:
        number, jobs = place
        if not number:
            Progress.began = time.perf_counter()
        each = (time.perf_counter() - Progress.began) / max(number, 1)
        after = f", then about {duration(each * (jobs - number - 1))}" if number else ""
        super().__init__(label if jobs == 1 else f"{number + 1}/{jobs}{after}: {label}", stream)
        self.records, self.started = records, self.shown
        self.iterations = sum(len(record) * record.iteration for record in records)
        self.frames = sum(int(record.frames.sum()) for record in records)

    def __call__(self) -> None:
        """Show the state after an iteration, if the last refresh is long enough ago."""
        if not self.due:
            return
        seconds, records = time.perf_counter() - self.started, self.records
        trials = sum(map(len, records))
        running = [record for record in records if record.active.any()] or records[-1:]
        done = sum(len(record) * record.iteration for record in records) - self.iterations
        todo = sum(len(record) * (record.max_iterations - record.iteration) for record in running)
        shards = f"{len(records) - len(running)}/{len(records)} shards, " if records[1:] else ""
        frames = sum(int(record.frames.sum()) for record in records) - self.frames
        self.show(
            done,
            done + todo,
            f"{shards}iteration {max(record.iteration for record in running)}, "
            f"converged {sum(int(record.converged.sum()) for record in records)}/{trials}, "
            f"mean score {sum(float(record.score.sum()) for record in records) / trials:.1f}, "
            f"{frames / seconds:,.0f} frames/s, < {duration(seconds / max(done, 1) * todo)} left",
        )


def printable(text: str) -> str:
    """A text from a file or a folder name, without terminal control characters."""
    return "".join(c if c.isprintable() else "?" for c in text)


def tell(message: object, kind: str = "error") -> None:
    """Print one line on stderr: what went wrong."""
    print(f"{kind}: {printable(str(message))}", file=sys.stderr)


def duration(seconds: float) -> str:
    """A time span in words: ``8 s``, ``3 min``, ``2.5 h``."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


def table(jobs: Iterable[Outcomes]) -> str:
    """The outcomes of the jobs, one line for each job.

    "passed" counts the trials whose training scores exceeded the threshold, "learned" those whose
    policy did without the strategy. "after" is the median of the iterations until then, over all
    trials; "> n" if fewer than half did so within n iterations. A dash: not recorded.
    """
    header = (
        "job", "trials", "passed", "after", "learned", "after", "mean score", "learned score",
        "frames", "seconds",
    )  # fmt: skip
    lines = text_table([header, *(_row(job) for job in jobs)], left={0})
    lines.insert(1, "-" * max(map(len, lines)))
    return "\n".join(lines)


def text_table(rows: Sequence[Sequence[str]], left: Collection[int]) -> list[str]:
    """The lines of a table with two spaces between columns; ``left`` lists left-aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if i in left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def warnings(jobs: Iterable[Outcomes]) -> list[str]:
    """Warnings about the results in the table, one line each."""
    short = [job for job in jobs if job.cut_short]
    if not short:
        return []
    caps = sorted({job.cap for job in short})
    windows = sorted({job.window for job in short})
    return [
        f"no trial could pass with max_iterations={'|'.join(map(str, caps))}: a score needs"
        f" score_window={'|'.join(map(str, windows))} episodes"
    ]


def _row(job: Outcomes) -> tuple[str, ...]:
    diverged = int((job.status == "diverged").sum())
    passed, after = _counted(job.passed, job.iterations_to_pass)
    return (
        job.name,
        str(len(job)),
        passed + (f", {diverged} diverged" if diverged else ""),
        after,
        *_counted(job.learned, job.iterations_to_learn),
        f"{job.score.mean():.1f}",
        "–" if job.learned_score is None else f"{job.learned_score.mean():.1f}",
        f"{int(job.frames.sum()):,}",
        f"{job.provenance['seconds']:.1f}",
    )


def _counted(
    event: NDArray[np.bool_] | None, iterations: NDArray[np.int64] | None
) -> tuple[str, str]:
    """How many trials had the event, and the median iterations until then."""
    if event is None or iterations is None:
        return "–", "–"
    median = lower_median(iterations, event)
    after = f"{median:.0f}" if np.isfinite(median) else f"> {iterations[~event].max()}"
    return f"{int(event.sum())} ({event.mean():.0%})", after
