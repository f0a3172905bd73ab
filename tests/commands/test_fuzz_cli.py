"""Any command line: either a right run, or one clear line and an exit status that is not 0.

The program's own ``main`` runs within this process, as a user's command would; a few commands run
in a process of their own. ``TRL_EXPLORE_FUZZ=1000`` tries so many.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from trl_explore.commands import train
from trl_explore.config import CONF, GROUPS
from trl_explore.jobs.reading import find_folders, read_job

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "train.py"
EXAMPLES = int(os.environ.get("TRL_EXPLORE_FUZZ", "60"))
OPTIONS = {group: [p.stem for p in sorted((CONF / group).glob("*.yaml"))] for group in GROUPS}
KEYS = [
    "seed", "trials", "first_trial", "episodes_per_update", "max_iterations", "score_threshold",
    "score_window", "episodes", "restart", "threads", "env.id", "env.max_steps", "env.kwargs",
    "strategy.temperature", "strategy.epsilon", "strategy.decay", "loss.gamma", "loss.weight",
    "loss.entropy", "optimizer.lr", "optimizer.betas", "optimizer.eps", "collector.threads",
    "policy.bias", "baseline.value",
]  # fmt: skip
NUMBERS = ["0", "1", "2", "3", "-1", "0.5", "1.0", "-0.0", "1e-3", "nan", "inf", "-inf", "1e400",
           str(2**63), "99999999999999999999999", "1_0", "0x10"]  # fmt: skip
NONSENSE = [
    "", "null", "true", "no", "x", "???", "'", '"', "[", "[1,2]", "[]", "{}", "{a:1}", "{a:{b:1}}",
    "${seed}", "${nothing}", "${oc.env:NO_SUCH_VARIABLE}", "${job_name:}", "${eval:1+1}", "1,2",
    "range(1,3)", "choice(1,2)", "interval(0,1)", "glob(*)", "a b", "ü", "🂡", "../..", "<b>&amp;",
    "\\textbf{x}", "%s%n", "\t", "a" * 300, "[[[[1]]]]", "{_target_:os.getcwd}",
    "{_target_:trl_explore.strategies.schedules.Linear,initial:1,final:0,iterations:3}",
    "[0.1,nan,0.2]",
]  # fmt: skip
WHOLE = [
    "nonsense", "=", "==", "a=b=c", "+", "~", "~seed", "~strategy", "~env.id", "+foo=1", "++foo=1",
    "+strategy.foo=1", "strategy._target_=os.getcwd", "loss._target_=nothing.at.all",
    "strategy._partial_=x", "env._convert_=x", "hydra/launcher=nope", "hydra/sweeper=nope",
    "hydra.mode=MULTIRUN", "hydra.mode=x", "hydra.sweeper=null", "hydra.launcher=null",
    "hydra.run.dir=null", "hydra.sweep.subdir=null", "hydra.job.chdir=true", "hydra.verbose=x",
    "hydra.job_logging=null", "hydra.callbacks=x", "experiment=nope",
    "experiment=[debug]", "strategy=[softmax,argmax]", "env/cartpole=x", "strategy@loss=softmax",
    "-m", "--multirun", "output_dir=", "output_dir=null", "output_dir=a b/ü", "output_dir=[1]",
    "output_dir=x=y", "output_dir='<b>'", "seed=1,1.0", "strategy=softmax,argmax",
]  # fmt: skip

values = st.sampled_from(NUMBERS + NONSENSE) | st.text(
    st.characters(codec="utf-8", exclude_characters="\0"), max_size=8
)
assignments = st.builds(
    "{}{}={}".format, st.sampled_from(["", "", "", "+", "++", "~"]), st.sampled_from(KEYS), values
)
choices = st.sampled_from([f"{g}={o}" for g in GROUPS for o in [*OPTIONS[g], "nope", "null"]])
arguments = st.lists(assignments | choices | st.sampled_from(WHOLE), min_size=1, max_size=4)


class Ran(NamedTuple):
    status: int
    stdout: str
    stderr: str

    @property
    def complaints(self) -> list[str]:
        return [
            line for line in self.stderr.splitlines() if not line.startswith(("collector: ", "\r"))
        ]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run a command in an empty folder of its own, and return that folder too."""
    place = tmp_path_factory.mktemp("fuzz")

    def run(arguments: list[str]) -> tuple[Ran, Path]:
        shutil.rmtree(place)
        place.mkdir()
        out, err = io.StringIO(), io.StringIO()
        before = dict(os.environ)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", [str(SCRIPT), "experiment=debug", "env.max_steps=10",
                                        "max_iterations=2", "trials=2", *arguments])  # fmt: skip
            patch.chdir(place)
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                try:
                    status = train.main()
                except SystemExit as error:
                    status = error.code if isinstance(error.code, int) else 1
                finally:
                    GlobalHydra.instance().clear()
                    HydraConfig.instance().cfg = None
                    os.environ.clear()
                    os.environ.update(before)
        return Ran(status, out.getvalue(), err.getvalue()), place

    return run


def check(ran: Ran, place: Path) -> None:
    """What holds of every command, whatever it says."""
    jobs = find_folders(place)
    for job, finished in jobs:
        assert finished, f"{job} is half a job"
        assert len(read_job(job))
    assert "Traceback" not in ran.stdout + ran.stderr
    if ran.status == 0:
        assert ran.complaints == []
        assert jobs
        assert "results: " in ran.stdout
    else:
        assert ran.complaints
        assert all(line.strip() for line in ran.complaints)
        if not jobs:  # of a sweep, each job that failed has its line
            assert ran.stdout == ""
            assert [p for p in place.rglob("*") if p.is_file()] == []


@settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=EXAMPLES < 100,
    suppress_health_check=list(HealthCheck),
)
@example(["strategy.temperature=1.5"])
@given(arguments)
def test_any_command_runs_or_says_why_not(run, arguments):
    ran, place = run(arguments)
    check(ran, place)
    sweep = any("error: " in line for line in ran.complaints[1:])
    if ran.status != 0 and not sweep and not ran.stderr.startswith("usage"):
        (line,) = ran.complaints
        assert line.startswith("error: ")


@pytest.mark.parametrize("whole", WHOLE)
def test_every_oddity_by_itself(run, whole):
    check(*run([whole]))
