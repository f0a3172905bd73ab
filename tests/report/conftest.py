"""Sweeps of invented results, written as files, so that the report runs as it does for a user."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from trl_explore.jobs.reading import read_job
from trl_explore.report import image_files
from trl_explore.statistics.outcomes import Outcomes
from trl_explore.training.diagnostic_quantities import DIAGNOSTIC_COLUMNS


def write_job(
    sweep: Path,
    name: str,
    durations: Any,
    *,
    strategy: str = "softmax",
    experiment: str | None = None,
    parameters: dict[str, Any] | None = None,
    cap: int = 1000,
    seed: int = 0,
    diverged: tuple[int, ...] = (),
    episodes: bool = True,
    env: str = "CartPole-v1",
    groups: dict[str, Any] | None = None,
    diagnostics: bool = False,
    evaluate_every: int = 0,
    stop_on: str = "training",
    threshold: float = 195.0,
    learned: Any = None,
    learned_score: float = 300.0,
    assumes: dict[str, Any] | None = None,
) -> Path:
    """A finished job whose trials took ``durations``; those at the cap were stopped there.

    ``learned``: iterations to learning; a trial that had not learned when it stopped has None.
    ``assumes``: the strategy that its correction names.
    """
    job = sweep / name
    (job / ".hydra").mkdir(parents=True)
    (job / ".hydra" / "overrides.yaml").write_text(f"- strategy={strategy}\n- output_dir=/x\n")
    lines, rows = [], []
    for k, n in enumerate(durations):
        passed = n < cap and k not in diverged
        status = "diverged" if k in diverged else "converged" if passed else "capped"
        score = 196.0 + k / 100 if passed else 20.0 + k
        frames = 20 * n + k + 1
        line = f"{k},{seed},{n},{passed},{score},{frames},0.5,{status}"
        if learned is not None:
            known, until = learned[k] is not None, n if learned[k] is None else learned[k]
            spent = frames if until == n else min(20 * until, frames)
            line += f",{passed},{n},{frames},{known},{until},{spent},{learned_score + k}"
        lines.append(line)
        rows += [f"{k},{i},{score * i / n},20" for i in range(1, n)]
        rows.append(f"{k},{n},{score},{20 + k + 1}")
    columns = "trial,iteration,score,frames"
    if diagnostics:
        columns = ",".join([columns, *DIAGNOSTIC_COLUMNS])
        # Behind the four columns of an episode: entropies, KL, ratio, size, shares, cells, norm.
        rows = [f"{row},0.6,0.4,0.1,0.9,0.8,0.25,0.6,{10 + k},3.5" for k, row in enumerate(rows)]
    if evaluate_every:
        played = [
            f"{k},{i},{200.0 + i}"
            for i in range(evaluate_every, max(durations) + 1, evaluate_every)
            for k, n in enumerate(durations)
            if i <= n
        ]
        text = "\n".join(["trial,iteration,score", *played]) + "\n"
        (job / "evaluations.csv").write_text(text)
    header = "trial,seed,iterations,converged,score,frames,seconds,status"
    if learned is not None:
        header += ",passed,iterations_to_pass,frames_to_pass"
        header += ",learned,iterations_to_learn,frames_to_learn,learned_score"
    (job / "trials.csv").write_text("\n".join([header, *lines]) + "\n")
    if episodes:
        (job / "episodes.csv").write_text("\n".join([columns, *rows]) + "\n")
    options = {group: {"_target_": f"x.{name}"} for group, name in (groups or {}).items()}
    if assumes is not None:
        options["correction"] = {"_target_": "x.AsIf", "strategy": {"_target_": "x", **assumes}}
    run = {
        "experiment": experiment or sweep.name,
        "strategy": strategy,
        "seed": seed,
        "trials": len(lines),
        "collector": "FusedCollector",
        "seconds": 1.5,
        "config": {
            "max_iterations": cap,
            "score_threshold": threshold,
            "score_window": 100,
            "evaluate_every": evaluate_every,
            "evaluate_episodes": 1,
            "stop_on": stop_on,
            "env": {"id": env},
            "strategy": {"_target_": "x", **(parameters or {})},
            **options,
        },
        "versions": {"python": "3.11.7", "torch": "2.13.0"},
        "machine": {"system": "Linux", "processor": "x86_64"},
    }
    (job / "run.json").write_text(json.dumps(run))
    return job


@contextmanager
def only_svg() -> Iterator[None]:
    """Figures as PNG and PDF take most of the time of a report; ``test_render`` draws them."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("to_png", "to_pdf"):
            patch.setattr(image_files, name, lambda figure: b"")
        yield


@pytest.fixture(autouse=True, scope="module")
def _only_svg() -> Iterator[None]:
    with only_svg():
        yield


@pytest.fixture(scope="session")
def make_job() -> Callable[..., Path]:
    return write_job


@pytest.fixture
def make(tmp_path: Path) -> Callable[..., Outcomes]:
    """Outcomes of an invented job."""

    def outcomes(durations: Any, **kwargs: Any) -> Outcomes:
        count = len(list(tmp_path.iterdir()))
        name = kwargs.pop("name", kwargs.get("strategy", "softmax"))
        sweep = tmp_path / f"made{count}" / kwargs.pop("sweep", "thesis")
        return read_job(write_job(sweep, name, durations, **kwargs))

    return outcomes


def write_study(folder: Path, trials: int = 12) -> Path:
    """The three experiments of the thesis, in miniature, with timings."""
    rng = np.random.default_rng(7)
    medians = {"random": 1000, "argmax": 800, "epsilon_greedy": 380,
               "decaying_epsilon_greedy": 190, "softmax": 150}  # fmt: skip
    parameters = {"epsilon_greedy": {"epsilon": 0.3}, "decaying_epsilon_greedy": {"decay": 0.99},
                  "softmax": {"temperature": 1.0}}  # fmt: skip

    def durations(median: float, cap: int, n: int) -> list[int]:
        drawn = (median * np.exp(rng.normal(0, 0.35, n))).astype(int)
        return [cap] * n if median >= cap else np.clip(drawn, 100, cap).tolist()

    timings = ["experiment,job,trial,seconds,frames"]
    for name, median in medians.items():
        taken = durations(median, 1000, trials)
        write_job(folder / "thesis", name, taken, strategy=name, parameters=parameters.get(name))
        timings += [f"thesis,{name},{k},{n / 4000:.6f},1" for k, n in enumerate(taken[:8])]
    (folder / "thesis" / "timings.csv").write_text("\n".join(timings) + "\n")
    for k, epsilon in enumerate((0.1, 0.2, 0.3, 0.5)):
        taken = durations((400, 300, 380, 1000)[k], 1000, 6)
        write_job(folder / "epsilon_grid", f"epsilon={epsilon}", taken,
                  strategy="epsilon_greedy", parameters={"epsilon": epsilon})  # fmt: skip
    for k, decay in enumerate((0.9, 0.98, 0.99)):
        taken = durations((4000, 300, 200)[k], 5000, 6)
        write_job(folder / "decay_grid", f"decay={decay}", taken, cap=5000,
                  strategy="decaying_epsilon_greedy", parameters={"decay": decay})  # fmt: skip
    return folder


class Made(NamedTuple):
    """A report that was made: its folder, its page, and what was missing."""

    study: Path
    out: Path
    html: str
    gaps: list[Any]


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """The report on the miniature study."""
    from trl_explore.report.writing import build_report

    study = write_study(tmp_path_factory.mktemp("study"))
    out = tmp_path_factory.mktemp("out")
    with only_svg():
        page, gaps = build_report([study], out)
    return Made(study, out, page.read_text(encoding="utf-8"), gaps)


def write_layouts(folder: Path) -> Path:
    """Strategies x corrections with everything recorded, and a plane of two numbers."""
    rng = np.random.default_rng(5)
    parameters = {"epsilon_greedy": {"epsilon": 0.3}, "softmax": {"temperature": 1.0}}
    medians = {"argmax": 900, "epsilon_greedy": 380, "softmax": 150}
    for strategy, median in medians.items():
        for correction in ("NoCorrection", "PerStep", "Trajectory"):
            taken = np.clip((median * np.exp(rng.normal(0, 0.2, 8))).astype(int), 100, 1000)
            write_job(
                folder / "corrections", f"{strategy},{correction}", taken.tolist(),
                strategy=strategy, parameters=parameters.get(strategy),
                groups={"correction": correction}, diagnostics=True, evaluate_every=50,
            )  # fmt: skip
    for epsilon in (0.0, 0.1, 0.3):
        for temperature in (0.5, 1.0, 1.5):
            passes = temperature <= 1
            taken = [150 + k if passes else 1000 for k in range(6)]
            write_job(
                folder / "mixture_plane", f"{epsilon},{temperature}", taken,
                strategy="epsilon_softmax",
                parameters={"epsilon": epsilon, "temperature": temperature},
            )  # fmt: skip
    return folder


def write_crossing(folder: Path, trials: int = 40, env: str = "CartPole-v1") -> Path:
    """Softmax, ε-greedy and argmax, each with a right and a biased gradient, by both measures.

    Means of the iterations to learning: softmax 40, ε-greedy 340 (corrected 70, its bias under
    softmax 310), argmax 540 (corrected 540).
    """
    rng = np.random.default_rng(11)
    epsilon, temperature = {"epsilon": 0.3}, {"temperature": 1.0}

    def job(name: str, mean: int, strategy: str, parameters: Any, **more: Any) -> None:
        learned = (mean + rng.integers(-20, 21, trials)).tolist()
        taken = [min(1000, n + 110) for n in learned]
        write_job(folder, name, taken, strategy=strategy, parameters=parameters, env=env,
                  learned=learned, evaluate_every=20, **more)  # fmt: skip

    for correction, softmax, greedy, argmax in (
        ("NoCorrection", 40, 340, 540), ("PerStep", 40, 70, 540),
    ):  # fmt: skip
        groups = {"correction": correction}
        job(f"softmax,{correction}", softmax, "softmax", temperature, groups=groups)
        job(f"epsilon_greedy,{correction}", greedy, "epsilon_greedy", epsilon, groups=groups)
        job(f"argmax,{correction}", argmax, "argmax", None, groups=groups)
    job("softmax,as_if_epsilon", 310, "softmax", temperature, assumes=epsilon)
    return folder


@pytest.fixture(scope="session")
def layouts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders of configurations in layouts."""
    return write_layouts(tmp_path_factory.mktemp("layouts"))
