"""Watch agents of finished jobs: ``trl-explore watch JOB [JOB ...] [--trial k] [--iteration i]``.

The film shows one episode of one agent of every job, side by side; with several iterations, one for
each of them. It is an episode of the program's own: with the strategy, the training episode that
follows the iteration; with --greedy, an episode of the evaluation after it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import product
from pathlib import Path

from trl_explore import config as configuration
from trl_explore.config import ConfigError
from trl_explore.config.composing import RecordedJob, recompose_all
from trl_explore.jobs.console import tell
from trl_explore.jobs.reading import read_job
from trl_explore.report.factors import configuration_labels

MOST = 12
"""Most jobs in one film."""
PACKAGES = {"PIL": "pillow", "imageio": "imageio", "imageio_ffmpeg": "imageio-ffmpeg"}
"""Modules of the extra ``watch``, and their packages."""


def film(
    jobs: list[RecordedJob],
    trial: int | None,
    iterations: Sequence[int | None],
    greedy: bool,
    out: Path,
) -> list[str]:
    """Write the film; returns a line on each episode."""
    from trl_explore.show.film import ROW, FilmPanel, write_film
    from trl_explore.show.playing import play

    if (number := len(jobs) * len(iterations)) > MOST:
        raise ConfigError(f"a film shows at most {MOST} episodes, got {number}")
    labels = configuration_labels([read_job(job.folder) for job in jobs])
    panels, lines = [], []
    for job, iteration in product(jobs, iterations):
        number = int(job.trials["trial"].iloc[0]) if trial is None else trial
        episode = play(job, number, iteration, greedy=greedy)
        title = labels[job.folder.name]
        title += ", without exploration" if greedy else ""
        when = f"trial {episode.trial} after {episode.iteration} iterations"
        when += " (its last)" if episode.stopped else ""
        panels.append(FilmPanel(title, when, episode))
        line = f"{title}: {when}, score {round(episode.score, 1):g} in {len(episode.action)} steps"
        if episode.exploratory is not None and not greedy:
            line += f", {episode.exploratory.sum()} of them exploratory"
        lines.append(line)
    write_film(out, panels, len(iterations) if len(iterations) > 1 else ROW)
    return lines


def main() -> int:
    """Write a film; an error prints one line on stderr and returns status 1."""
    parser = argparse.ArgumentParser(
        description="Film one episode of one agent of every job, side by side. Actions that differ"
        " from the one that the policy prefers are marked."
    )
    parser.add_argument("folders", nargs="+", type=Path, metavar="JOB", help="job or sweep folder")
    parser.add_argument("--trial", type=int, help="the agent (default: the first of each job)")
    when = parser.add_mutually_exclusive_group()
    when.add_argument(
        "--iteration", type=int, nargs="+", metavar="I",
        help="its weights after I iterations; several: one column for each",
    )  # fmt: skip
    when.add_argument("--final", action="store_true", help="its final weights (default)")
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--greedy", action="store_true", help="the policy without its strategy")
    how.add_argument("--behaviour", action="store_true", help="with its strategy (default)")
    parser.add_argument(
        "--out", type=Path, default=Path("watch.gif"), metavar="FILE",
        help="FILE.gif or FILE.mp4 (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--config-dir", type=Path, metavar="DIR", help="the --config-dir used to train the jobs"
    )
    arguments = parser.parse_args()
    out = arguments.out
    try:
        if out.suffix not in (".gif", ".mp4"):
            raise ConfigError(f"--out must end in .gif or .mp4, got {out}")
        if not out.parent.is_dir():
            raise ConfigError(f"--out {out}: no such folder")
        iterations = arguments.iteration or [None]
        if (lowest := min(arguments.iteration or [0])) < 0:
            raise ConfigError(f"--iteration must be >= 0, got {lowest}")
        jobs = recompose_all(arguments.folders, arguments.config_dir)
        lines = film(jobs, arguments.trial, iterations, arguments.greedy, out)
    except ModuleNotFoundError as error:
        if error.name not in PACKAGES:
            raise
        tell(f"{PACKAGES[error.name]} is not installed: pip install 'trl_explore[watch]'")
        return 1
    except configuration.ERRORS as error:
        tell(configuration.describe(error))
        return 1
    print("\n".join([*lines, str(out)]))
    return 0
