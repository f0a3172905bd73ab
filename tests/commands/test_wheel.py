"""The wheel: what it holds, and its commands in an environment of its own, from any folder."""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
JOB = ["train", "experiment=debug", "trials=1", "max_iterations=2", "collector=torchrl"]
SOURCES = ("trl_explore", "conf", "pyproject.toml", "setup.py", "README.md", "LICENSE")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Built offline, from a copy: setuptools writes into the folder that it builds from."""
    place = tmp_path_factory.mktemp("wheel")
    for name in SOURCES:
        if (ROOT / name).is_dir():
            ignored = shutil.ignore_patterns("__pycache__", "*.nb[ic]")
            shutil.copytree(ROOT / name, place / "source" / name, ignore=ignored)
        else:
            shutil.copy(ROOT / name, place / "source" / name)
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-q"]
    subprocess.run([*command, "-w", str(place), str(place / "source")], check=True)
    (built,) = place.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """The scripts of an environment with the wheel, which sees the packages of this one."""
    place = tmp_path_factory.mktemp("installed")
    venv.create(place, symlinks=True)
    scripts, site = (
        Path(sysconfig.get_path(name, "venv", vars={"base": str(place)}))
        for name in ("scripts", "purelib")
    )
    command = [sys.executable, "-m", "pip", "--python", str(scripts / "python"), "install"]
    subprocess.run([*command, "-q", "--no-deps", "--no-index", str(wheel)], check=True)
    (site / "packages.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return scripts


def run(scripts: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [scripts / "trl-explore", *words],
        cwd=folder,
        env={"PATH": str(scripts), "HOME": str(folder)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_it_holds_every_file_that_the_program_reads(wheel):
    held = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    files = [path for place in ("trl_explore", "conf") for path in (ROOT / place).rglob("*.*")]
    names = {p.relative_to(ROOT).as_posix() for p in files if "__pycache__" not in p.parts}
    assert held == {f"trl_explore/{n}" if n.startswith("conf/") else n for n in names}


def test_its_commands_work_from_any_folder(installed, tmp_path):
    trained = run(installed, tmp_path, *JOB)
    assert trained.returncode == 0, trained.stderr
    (job,) = (tmp_path / "outputs" / "debug").iterdir()
    for words in (
        ["status", "outputs"],
        ["time", "outputs", "--trials", "1"],
        ["verify", "outputs"],
        ["report", str(job)],
    ):
        done = run(installed, tmp_path, *words)
        assert done.returncode == 0
        assert words[0] == "report" or done.stderr == ""  # it says what it draws
    assert (job.parent / "timings.csv").is_file()
    assert (job / "report" / "index.html").is_file()


def test_files_of_the_user_stand_beside_those_of_the_package(installed, tmp_path):
    folder = tmp_path / "mine" / "strategy"
    folder.mkdir(parents=True)
    text = "_target_: trl_explore.strategies.EpsilonGreedy\nepsilon: 0.25\n"
    (folder / "quarter.yaml").write_text(text)
    (folder / "softmax.yaml").write_text(
        "_target_: trl_explore.strategies.Softmax\ntemperature: 5.0\n"
    )
    own = ["--config-dir", str(tmp_path / "mine")]
    trained = run(installed, tmp_path, *JOB, *own, "strategy=quarter")
    assert trained.returncode == 0, trained.stderr
    (job,) = (tmp_path / "outputs" / "debug").iterdir()
    assert job.name.startswith("quarter,")
    unknown, timed = (run(installed, tmp_path, "time", str(job), *words) for words in ([], own))
    assert unknown.returncode == 1
    assert unknown.stderr.startswith("error: ")
    assert unknown.stderr.count("\n") == 1
    assert (timed.returncode, timed.stderr) == (0, "")
    replaced = run(installed, tmp_path, *JOB, *own, "strategy=softmax")
    assert replaced.returncode == 0, replaced.stderr
    assert any("temperature=5.0" in path.name for path in job.parent.iterdir())
    absent = run(installed, tmp_path, *JOB, "--config-dir", "absent")
    assert (absent.returncode, absent.stderr.count("\n")) == (1, 1)
    assert "absent" in absent.stderr


def test_a_missing_extra_is_one_line():
    """Without the packages of the laboratory, a command says what to install."""
    program = """
import sys
from importlib.abc import MetaPathFinder

class Without(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("hydra", "omegaconf", "pandas", "scipy", "matplotlib"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Without())
from trl_explore.commands.main import main
sys.exit(main(sys.argv[1:]))
"""
    for name in ("train", "report", "time"):
        done = subprocess.run(
            [sys.executable, "-c", program, name, "x"], cwd=ROOT, capture_output=True, text=True
        )
        assert done.returncode == 1
        assert done.stderr.endswith("is not installed: pip install 'trl_explore[lab]'\n")
        assert done.stderr.count("\n") == 1


def test_the_list_of_commands():
    program = "import sys; from trl_explore.commands.main import main; sys.exit(main())"
    shown, wrong = (
        subprocess.run(
            [sys.executable, "-c", program, *words], cwd=ROOT, capture_output=True, text=True
        )
        for words in ([], ["tarin"])
    )
    assert shown.returncode == 0
    assert [line.split()[0] for line in shown.stdout.splitlines()[2:-2]] == [
        "train", "settle", "tune", "report", "watch", "map", "status", "time", "verify",
        "thesis",
    ]  # fmt: skip
    assert (wrong.returncode, wrong.stdout) == (1, "")
    assert wrong.stderr.startswith("error: unknown command 'tarin'; available: train, settle, ")
    assert wrong.stderr.count("\n") == 1
