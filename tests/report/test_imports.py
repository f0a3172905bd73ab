import subprocess
import sys

PROGRAM = """
import importlib, pkgutil, runpy, sys
import trl_explore.report as package
names = [m.name for m in pkgutil.walk_packages(package.__path__, package.__name__ + ".")]
assert len(names) > 20, names
for name in names:
    importlib.import_module(name)
sys.argv = ["report.py", sys.argv[1], "--out", sys.argv[2]]
try:
    runpy.run_path(SCRIPT, run_name="__main__")
except SystemExit as stop:
    assert not stop.code, stop.code
heavy = {"torch", "tensordict", "torchrl", "hydra", "omegaconf", "numba"} & set(sys.modules)
assert not heavy, heavy
"""


def test_a_report_is_made_without_torch_or_hydra(tmp_path, make_job, request):
    make_job(tmp_path / "train", "softmax", [150, 200, 1000])
    script = request.config.rootpath / "scripts" / "report.py"
    program = PROGRAM.replace("SCRIPT", repr(str(script)))
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program, str(tmp_path), str(tmp_path / "out")],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "index.html").is_file()
