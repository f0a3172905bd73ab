"""What every test file may ask for: trials trained by the Python API, and the command line."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
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
    from trl_explore.training.trainer import Trainer
    from trl_explore.training.trials import Trials

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


class Ran(NamedTuple):
    """What became of a command; ``torch`` says whether torch has been imported by its end."""

    returncode: int
    stdout: str
    stderr: str
    torch: bool


class Driver:
    """A process of ``tests/driver.py`` that answers one batch of commands after the other."""

    SECONDS = 600

    def __init__(self, *options: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, str(ROOT / "tests" / "driver.py"), *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def ask(self, batch: Sequence[Any]) -> list[Ran]:
        process = self.process
        assert process.stdin is not None
        assert process.stdout is not None
        print(json.dumps(batch), file=process.stdin, flush=True)
        if not select.select([process.stdout], [], [], self.SECONDS)[0]:
            os.killpg(process.pid, signal.SIGKILL)
        answer = process.stdout.readline().strip()
        assert answer, "the commands ended their process, or took too long"
        return [Ran(*result) for result in json.loads(answer)]

    def close(self) -> None:
        with self.process:  # ends when its standard input does
            pass


@pytest.fixture(scope="session")
def run_many() -> Iterator[Callable[..., list[Ran]]]:
    """Many commands of a script, one after the other in one process, from the folder ``cwd``.

    A text among the commands is Python to execute. ``cold``: nothing has been imported before.
    """
    warm: list[Driver] = []

    def run(
        commands: Iterable[str | Sequence[str]],
        cwd: Path,
        script: Path = SCRIPT,
        cold: bool = False,
    ) -> list[Ran]:
        batch = [str(script), str(cwd), [c if isinstance(c, str) else list(c) for c in commands]]
        if cold:
            driver = Driver("--cold")
            try:
                return driver.ask(batch)
            finally:
                driver.close()
        if not warm:
            warm.append(Driver())
        return warm[0].ask(batch)

    yield run
    for driver in warm:
        driver.close()
