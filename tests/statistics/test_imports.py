import subprocess
import sys

PROGRAM = """
import importlib, pkgutil, sys
import trl_explore.analysis as package
names = [m.name for m in pkgutil.walk_packages(package.__path__, package.__name__ + ".")]
assert len(names) > 12, names
for name in names:
    importlib.import_module(name)
heavy = {"torch", "tensordict", "torchrl", "hydra", "omegaconf", "matplotlib"} & set(sys.modules)
assert not heavy, heavy
"""


def test_analysis_never_imports_torch_or_hydra():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
