"""``trl-explore tune [options] key=value ...``: tune each strategy, judge on other seeds."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from trl_explore import config as configuration
from trl_explore.commands import train
from trl_explore.commands.settle import run_jobs
from trl_explore.config import ConfigError
from trl_explore.config.tuning_value import measured, objective
from trl_explore.statistics.comparisons import ITERATIONS, SCORE, Measure
from trl_explore.statistics.outcomes import Outcomes, judged

RATE = "optimizer.lr"
GRIDS: Mapping[str, Mapping[str, str]] = {
    "boltzmann": {"temperature": "0.3,0.5,1,2,3"},
    "decaying_epsilon_greedy": {"decay": "0.95,0.97,0.98,0.99,0.995"},
    "epsilon_greedy": {"epsilon": "0.05,0.1,0.2,0.3,0.5"},
    "epsilon_softmax": {"epsilon": "0.01,0.05,0.1,0.2,0.3"},
    "softmax": {"temperature": "0.3,0.5,1,2,3"},
}
"""Strategy -> the values of its own parameters that are tried if none are given."""


def main() -> int:
    """Run the command; an error prints one line on stderr and returns status 1."""
    parser = argparse.ArgumentParser(
        usage="trl-explore tune [options] key=value ...",
        description="Tune the learning rate and the parameters of each strategy on one seed, and"
        " compare the best settings on another. The same command continues an interrupted run.",
        allow_abbrev=False,
        epilog="key=value is as in trl-explore train. strategy.NAME=A,B,... gives the values of"
        " a parameter to every strategy that has it.",
    )
    parser.add_argument("--trials", type=int, default=20, help="trials of each setting (20)")
    parser.add_argument("--judge", type=int, default=100, help="trials of the best setting (100)")
    parser.add_argument(
        "--seeds", type=int, nargs=2, default=[0, 1], metavar=("TUNING", "JUDGING"),
        help="the seeds of both steps (0 1)",
    )  # fmt: skip
    parser.add_argument(
        "--lr", default="0.003,0.01,0.03,0.1,0.3", help="learning rates, A,B,... (%(default)s)"
    )
    parser.add_argument(
        "--direction", choices=("minimize", "maximize"), default="minimize",
        help="minimize the mean time (default), or maximize the mean learned score",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, help="folder of the page (default: OUTPUT_DIR/report)")
    arguments, words = parser.parse_known_args()
    sys.argv[1:] = [word for word in words if word not in ("-m", "--multirun")]
    return train.main(partial(_tune, arguments))


def _tune(arguments: argparse.Namespace) -> int:
    from trl_explore.report.tuning import Tuned, build_page

    words = sys.argv[1:]
    for key in ("trials", "seed", "first_trial", RATE):
        if given := [w for w in words if re.match(rf"\+*{re.escape(key)}=", w)]:
            raise ConfigError(f"{given[0]}: tune chooses it; see trl-explore tune --help")
    strategies = _value(words, "strategy", "softmax,epsilon_greedy").split(",")
    place = Path(_value(words, "output_dir", "outputs/tuned"))
    own = [w for w in words if w.startswith("strategy.")]
    rest = [w for w in words if not re.match(r"(strategy|output_dir)[.=]", w)]
    tuning, judging = arguments.seeds
    found = []
    for strategy in strategies:
        grid = {RATE: arguments.lr} | _grid(strategy, own)
        swept = [f"{key}={values}" for key, values in grid.items()]
        base = [*rest, f"strategy={strategy}"]
        jobs = run_jobs(["-m", *base, *swept, f"seed={tuning}", f"trials={arguments.trials}",
                     f"output_dir={place / 'tuning'}"])  # fmt: skip
        tried = [(_settings(job, grid), _outcomes(job, arguments.direction)) for job in jobs]
        scores = [objective(o, arguments.direction) for _, o in tried]
        best = scores.index((min if arguments.direction == "minimize" else max)(scores))
        setting = [f"{key}={value:g}" for key, value in tried[best][0].items()]
        print(f"{strategy}: {' '.join(setting)} is the best of {len(tried)} settings", flush=True)
        (job,) = run_jobs([*base, *setting, f"seed={judging}", f"trials={arguments.judge}",
                       f"output_dir={place / 'judging'}", "hydra.mode=RUN"])  # fmt: skip
        found.append(Tuned(strategy, tried, best, _outcomes(job, arguments.direction)))
    measure: Measure = ITERATIONS if arguments.direction == "minimize" else SCORE
    out = arguments.out or place / "report"
    print(build_page(found, measure, out, tuning=tuning, judging=judging))
    return 0


def _value(words: Sequence[str], key: str, default: str) -> str:
    """The value of a key in the words of a command, the last one that gives it."""
    given = [word.partition("=")[2] for word in words if word.startswith(f"{key}=")]
    return given[-1] if given else default


def _grid(strategy: str, own: Sequence[str]) -> dict[str, str]:
    """The parameters of a strategy, each with its values: those given, or of ``GRIDS``."""
    known = configuration.files_of("strategy")
    if strategy not in known:
        raise ConfigError(f"strategy={strategy}: one of {', '.join(known)} is possible")
    file = OmegaConf.load(known[strategy])
    grid = {f"strategy.{key}": values for key, values in GRIDS.get(strategy, {}).items()}
    for word in own:
        key, _, values = word.partition("=")
        if isinstance(file, DictConfig) and key.removeprefix("strategy.") in file:
            grid[key] = values
    return grid


def _settings(job: Path, grid: Mapping[str, str]) -> dict[str, float]:
    """The values of the tuned parameters of a job."""
    config = OmegaConf.load(job / ".hydra" / "config.yaml")
    return {key: float(OmegaConf.select(config, key)) for key in grid}


def _outcomes(job: Path, direction: str) -> Outcomes:
    """The outcomes of a job, by the measure that is tuned."""
    from trl_explore.jobs.reading import read_job

    outcomes = read_job(job)
    if direction == "minimize":
        return measured(outcomes)
    return outcomes if outcomes.learned_score is None else judged(outcomes, "learned")
