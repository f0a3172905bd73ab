"""Running finished jobs again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

ROOT = Path(__file__).resolve().parents[2]
SHORT = ["trials=3", "first_trial=5", "max_iterations=12", "score_window=2"]


@pytest.fixture(scope="module")
def jobs(tmp_path_factory, run_many) -> list[Path]:
    """A job with the same parameter for all trials, and one with a value per trial."""
    out = tmp_path_factory.mktemp("verified")
    words = ["-m", "strategy=epsilon_greedy", "strategy.epsilon=0.2,[0.1,0.2,0.3]", *SHORT]
    (ran,) = run_many([[*words, f"output_dir={out}"]], out)
    assert ran.returncode == 0, ran.stderr
    return sorted(path for path in (out / "train").iterdir() if path.is_dir())


@pytest.fixture
def verify(run_many, tmp_path):
    def run(*folders):
        (ran,) = run_many([[str(f) for f in folders]], tmp_path, ROOT / "scripts" / "verify.py")
        return ran

    return run


def test_a_job_that_runs_again_is_equal(jobs, verify):
    ran = verify(jobs[0].parent)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout.splitlines() == [f"{job.name}: equal" for job in jobs]


def test_an_older_processor_gives_equal_results(jobs):
    """The C library, torch and NumPy choose other code for it: without AVX2 and fused products.

    ``tests/engines/pythons.sh`` also compiles the kernels for a generic processor.
    """
    older = {
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F",
        "ATEN_CPU_CAPABILITY": "default",
        "NPY_DISABLE_CPU_FEATURES": "AVX2,FMA3,AVX512F",
    }
    command = [sys.executable, str(ROOT / "scripts" / "verify.py"), str(jobs[0].parent)]
    ran = subprocess.run(
        command, env={**os.environ, **older}, capture_output=True, text=True, check=False
    )
    assert ran.stdout.splitlines() == [f"{job.name}: equal" for job in jobs], ran.stderr


def test_a_value_per_trial_is_timed_for_the_trial_that_has_it(jobs, run_many, tmp_path):
    words = [str(jobs[0].parent), "--trials", "3"]
    (ran,) = run_many([words], tmp_path, ROOT / "scripts" / "time_trials.py")
    assert (ran.returncode, ran.stderr) == (0, "")


def unsigned(job):
    """A copy of a job whose files nobody compares with their digests."""
    run = json.loads((job / "run.json").read_text())
    (job / "run.json").write_text(json.dumps({**run, "files": {}}))
    return job


def scale(by):
    def change(job):
        weights = load_file(job / "weights.safetensors")
        save_file({k: (w * by).astype(np.float32) for k, w in weights.items()},
                  job / "weights.safetensors")  # fmt: skip

    return change


def not_a_number(job):
    """In one trial; the weights of the others differ too."""
    weights = load_file(job / "weights.safetensors")
    for w in weights.values():
        w *= 2
        w[0] = np.nan
    save_file(weights, job / "weights.safetensors")


def other_names(job):
    weights = load_file(job / "weights.safetensors")
    save_file({f"old.{k}": w for k, w in weights.items()}, job / "weights.safetensors")


def other_score(job):
    lines = (job / "episodes.csv").read_text().splitlines()
    trial, iteration, score, frames = lines[14].split(",")
    lines[14] = ",".join([trial, iteration, str(float(score) + 1), frames])
    (job / "episodes.csv").write_text("\n".join(lines) + "\n")
    return f"iteration {iteration} on (trial {trial})"


@pytest.mark.parametrize(
    ("change", "status", "words"),
    [
        (scale(1 + 1e-6), 0, "equal within rounding"),
        (scale(1.0001), 1, "different"),
        (not_a_number, 1, "different: weights"),
        (other_names, 1, "different names or shapes of weights"),
        (other_score, 1, "different from"),
    ],
)
def test_the_first_difference_is_named(jobs, verify, tmp_path, change, status, words):
    job = unsigned(Path(copytree(jobs[0], tmp_path / jobs[0].name)))
    more = change(job) or ""
    ran = verify(job)
    assert ran.returncode == status, ran.stderr
    assert words in ran.stdout
    assert more in ran.stdout


def test_the_progress_of_a_job_is_shown_and_ends(jobs, monkeypatch):
    from trl_explore.commands import verify as command
    from trl_explore.config.composing import recompose_all

    said: list[object] = []

    class Progress:
        def __init__(self, label, records, place):
            said.extend((label, place))

        def __call__(self):
            said.append("iteration")

        def close(self):
            said.append("closed")

    monkeypatch.setattr(command, "Progress", Progress)
    assert command.verify(recompose_all([jobs[0]])[0], (2, 5)) == command.SAME
    assert said == [jobs[0].name, (2, 5), *["iteration"] * 12, "closed"]
