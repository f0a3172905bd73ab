"""``trl-explore settle [options] key=value ...``: add trials until every comparison is decided."""

from __future__ import annotations

import argparse
import csv
import json
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from trl_explore.commands import train
from trl_explore.config import ConfigError
from trl_explore.jobs.files import write_whole
from trl_explore.jobs.sweep_files import LOOKS, VERDICTS, read_json
from trl_explore.statistics import samples
from trl_explore.statistics.estimates import LEVEL, check_level
from trl_explore.statistics.outcomes import Outcomes, judged
from trl_explore.statistics.samples import Sample
from trl_explore.statistics.sequential import Verdict, planned_looks, settle

FIRST = 20
"""Trials of the first look."""
MEASURES: Mapping[str, Callable[[Outcomes], Sample]] = {
    "passed": lambda o: samples.iterations(judged(o, "passed")),
    "learned": lambda o: samples.iterations(judged(o, "learned")),
    "score": samples.scores,
    "learned_score": lambda o: samples.scores(judged(o, "learned")),
}
"""Name of a measure -> its sample; the times are restricted to the cap."""


def main() -> int:
    """Run the command; an error prints one line on stderr and returns status 1."""
    parser = argparse.ArgumentParser(
        usage="trl-explore settle [options] key=value ...",
        description="Run a sweep with more and more trials until each pair of configurations is"
        " decided, or the trials are used up. The probability that any difference is found where"
        " there is none is at most 1 - level. The same command continues an interrupted run.",
        allow_abbrev=False,
        epilog="key=value is as in trl-explore train, without trials and first_trial.",
    )
    parser.add_argument("--first", type=int, help="trials of the first look (20)")
    parser.add_argument(
        "--most", type=int, default=500, help="most trials of a configuration (500)"
    )
    parser.add_argument(
        "--measure", choices=MEASURES, default="passed", help="what is compared (passed: the"
        " iterations until a trial passes)",
    )  # fmt: skip
    parser.add_argument("--level", type=float, default=LEVEL, help="1 - error of all looks (0.95)")
    parser.add_argument("--margin", type=float, help="differences below this count as equal")
    arguments, words = parser.parse_known_args()
    sys.argv[1:] = ["-m", *(word for word in words if word not in ("-m", "--multirun"))]
    return train.main(partial(_settle, arguments))


def _settle(arguments: argparse.Namespace) -> int:
    words = sys.argv[1:]
    if given := [w for w in words if re.match(r"\+*(trials|first_trial)=", w)]:
        raise ConfigError(f"{given[0]}: settle chooses it; --first and --most bound the trials")
    check_level(arguments.level)
    first = min(FIRST, arguments.most) if arguments.first is None else arguments.first
    looks = planned_looks(first, arguments.most)
    jobs = _Jobs(words, looks[0], MEASURES[arguments.measure])
    plan = {"looks": looks, "words": words} | {
        name: getattr(arguments, name) for name in ("measure", "level", "margin")
    }
    jobs.record(plan)
    names = list(jobs.folders)
    if len(names) < 2:
        raise ConfigError("settle compares configurations: the sweep has only one")
    verdicts = settle(
        list(combinations(names, 2)), jobs.more, looks, level=arguments.level,
        margin=arguments.margin, on_look=partial(_show_look, looks),
    )  # fmt: skip
    _report(jobs.sweep / VERDICTS, verdicts)
    used, most = sum(jobs.trials.values()), looks[-1] * len(names)
    still = sum(v.result == "open" for v in verdicts)
    rest = f"; {still} of {len(verdicts)} pairs open" if still else ""
    print(f"{used:,} trials of at most {most:,} ({100 * (1 - used / most):.0f} % saved){rest}")
    print(f"results: {jobs.sweep}")
    return 0


class _Jobs:
    """The jobs of every configuration: the first of each by one sweep, further ones alone."""

    def __init__(
        self, words: Sequence[str], first: int, measure: Callable[[Outcomes], Sample]
    ) -> None:
        self.measure = measure
        self.flags = _flags(words)
        self.trials: dict[str, int] = {}
        self.folders: dict[str, list[Path]] = {}
        found = run_jobs([*words, f"trials={first}"])
        self.sweep = found[0].parent
        parts = [folder.name.split(",") for folder in found]
        common = set.intersection(*map(set, parts))
        for folder, words in zip(found, parts, strict=True):
            name = ",".join(word for word in words if word not in common) or folder.name
            self.folders[name], self.trials[name] = [folder], first

    def record(self, plan: Mapping[str, Any]) -> None:
        """Write the plan, or check that it is the one of an interrupted run.

        Raises:
            ConfigError: the looks were planned differently; the error would not be held.
        """
        file = self.sweep / LOOKS
        if (old := read_json(file)) is not None:
            if changed := [key for key in plan if old.get(key) != plan[key]]:
                raise ConfigError(
                    f"{file} plans {changed[0]}={old.get(changed[0])}, not {plan[changed[0]]}: a"
                    " plan that is changed after a look does not hold its error; use another"
                    " output_dir"
                )
        else:
            write_whole(file, f"{json.dumps(plan)}\n".encode())

    def more(self, names: Sequence[str], n: int) -> dict[str, Sample]:
        """The samples of configurations, after running what they lack of n trials."""
        from trl_explore.jobs.reading import read_job
        from trl_explore.statistics.pairing import check_comparable, pool

        found = {}
        for name in names:
            if (have := self.trials[name]) < n:
                words = [w for w in _overrides(self.folders[name][0]) if w[:7] != "trials="]
                batch = [f"trials={n - have}", f"first_trial={have}", "hydra.mode=RUN"]
                self.folders[name] += run_jobs([*self.flags, *words, *batch])
                self.trials[name] = n
            found[name] = pool([read_job(folder) for folder in self.folders[name]])
        for a, b in combinations(found.values(), 2):
            check_comparable(a, b)
        return {name: self.measure(outcomes) for name, outcomes in found.items()}


def run_jobs(words: Sequence[str]) -> list[Path]:
    """The folders of the jobs of a command; an error if any failed."""
    sys.argv[1:] = words
    jobs = train.run_jobs()
    if failed := [job for job in jobs if job.error]:
        raise ConfigError(f"{len(failed)} of {len(jobs)} jobs failed: {failed[0].line}")
    return list(dict.fromkeys(job.folder for job in jobs))


def _flags(words: Sequence[str]) -> list[str]:
    """The words that are no override: ``--config-dir`` and its folder."""
    return [w for w in words if w != "-m" and ("=" not in w or w.startswith("--"))]


def _overrides(folder: Path) -> list[str]:
    """The words that compose a job."""
    return [str(word) for word in OmegaConf.load(folder / ".hydra" / "overrides.yaml")]


def _show_look(looks: Sequence[int], verdicts: Sequence[Verdict]) -> None:
    k = max(v.look for v in verdicts)
    decided = sum(v.result != "open" for v in verdicts)
    print(f"look {k} of at most {len(looks)}: {looks[k - 1]:,} trials, {decided} of {len(verdicts)}"
          " pairs decided", flush=True)  # fmt: skip


def _report(file: Path, verdicts: Sequence[Verdict]) -> None:
    """Write the table of verdicts, and print it."""
    from trl_explore.jobs.console import text_table

    header = ["first", "second", "greater mean", "difference", "low", "high", "trials"]
    rows = [
        [v.a, v.b, v.result, v.difference.value, v.difference.low, v.difference.high, v.trials]
        for v in verdicts
    ]
    with file.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([header, *rows])
    shown = [[f"{x:.4g}" if isinstance(x, float) else str(x) for x in row] for row in rows]
    print("\n".join(text_table([header, *shown], left={0, 1, 2})))
