"""What every test file may ask for: trials trained by the Python API, and the command line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).resolve().parent.parent
SCRIPT = ROOT / "scripts" / "train.py"


def pytest_configure(config: pytest.Config) -> None:
    # torchrl 0.14 warns of three classes of its own when torchrl.collectors is imported.
    config.addinivalue_line(
        "filterwarnings",
        r"ignore:Creating \w+ which inherits from WeightUpdaterBase is deprecated"
        ":DeprecationWarning",
    )


def build_trainer(
    strategy: Any,
    trials: int = 2,
    first_trial: int = 0,
    seed: int = 0,
    *,
    id: str = "CartPole-v1",
    max_steps: int | None = 500,
    max_iterations: int = 10,
    score_window: int = 4,
    score_threshold: float = 30.0,
    gamma: float = 0.99,
    lr: float = 0.05,
    optimizer: Any = None,
    loss: Any = None,
    collector: Any = None,
    on_iteration: Any = None,
) -> Any:
    """A trainer that has not run; ``collector``, ``loss`` and ``optimizer`` are constructors."""
    import torch
    from tensordict.nn import TensorDictSequential

    from trl_explore.collectors import TorchRLCollector
    from trl_explore.envs import make_env
    from trl_explore.objectives import ReinforceLoss
    from trl_explore.policies import LinearPolicy
    from trl_explore.policies.actor import SoftmaxActor
    from trl_explore.training.optimizers import LaneAdam
    from trl_explore.training.record import Trials
    from trl_explore.training.trainer import Trainer

    torch.set_num_threads(1)
    env = make_env(id, trials, max_steps, seed=seed, first_trial=first_trial)
    policy = LinearPolicy(env, seed=seed, first_trial=first_trial)
    return Trainer(
        (collector or TorchRLCollector)(env, TensorDictSequential(policy, strategy)),
        (loss or ReinforceLoss)(
            SoftmaxActor(policy), gamma=gamma, weight=lr, trials=trials, functional=False
        ),
        (optimizer or partial(LaneAdam, lr=lr))(policy.parameters()),
        Trials(
            trials,
            max_iterations=max_iterations,
            score_threshold=score_threshold,
            score_window=score_window,
        ),
        on_iteration=on_iteration,
    )


@pytest.fixture(scope="session")
def build() -> Callable[..., Any]:
    """``build_trainer``."""
    return build_trainer


@pytest.fixture(scope="session")
def train() -> Callable[..., Any]:
    """Build a trainer, run it and return it."""

    def run(*args: Any, **kwargs: Any) -> Any:
        trainer = build_trainer(*args, **kwargs)
        trainer.run()
        return trainer

    return run


@pytest.fixture(scope="session")
def run_cli() -> Callable[..., subprocess.CompletedProcess[str]]:
    """``python scripts/train.py *args`` in a process of its own, from the folder ``cwd``."""

    def run(
        *args: str, cwd: Path, environment: dict[str, str] | None = None
    ) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, str(SCRIPT), *args],
            cwd=cwd,
            env={**os.environ, **(environment or {})},
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )

    return run


# What the shell would do with each command, one after the other in one process; a text in their
# midst is Python.
DRIVER = """
import contextlib, io, json, os, runpy, sys, traceback
from hydra.core.global_hydra import GlobalHydra

script, results = sys.argv[1], []
for arguments in json.load(sys.stdin):
    if isinstance(arguments, str):
        exec(arguments)
        continue
    GlobalHydra.instance().clear()
    os.environ.pop("HYDRA_FULL_ERROR", None)
    sys.argv = [script, *arguments]
    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            runpy.run_path(script, run_name="__main__")
        except SystemExit as exit:
            code = exit.code or 0
        except BaseException:
            traceback.print_exc()
            code = 1
    results.append([code, out.getvalue(), err.getvalue(), "torch" in sys.modules])
json.dump(results, sys.stdout)
"""


class Ran(NamedTuple):
    """What became of a command; ``torch`` says whether torch has been imported by its end."""

    returncode: int
    stdout: str
    stderr: str
    torch: bool


@pytest.fixture(scope="session")
def run_many() -> Callable[..., list[Ran]]:
    """Many commands of ``scripts/train.py``, one after the other in one process."""

    def run(commands: Iterable[str | Sequence[str]], cwd: Path) -> list[Ran]:
        process = subprocess.run(
            [sys.executable, "-c", DRIVER, str(SCRIPT)],
            input=json.dumps([c if isinstance(c, str) else list(c) for c in commands]),
            cwd=cwd,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert process.returncode == 0, process.stderr
        return [Ran(*result) for result in json.loads(process.stdout)]

    return run
